"""The vocabulary of URDF: its schema, and the extensions of the programs that read it.

Sources: urdf.xsd of urdfdom, and its versions 1.1 and 1.2; URDF+; the extensions of Drake, of Gazebo (`<gazebo>`), of
Isaac Sim, of MuJoCo (`<mujoco>`) and of Bullet (`<contact>`), as their manuals list them.
"""

from __future__ import annotations

from mbsgen.importing.vocabulary import Vocabulary, place, warning

_XACRO = ("this is xacro", "run `xacro FILE > robot.urdf`, and import that")
_ACTS = "is not part of the model; loops are read from <loop> and <coupling>"
_OF_SDF = "is not part of the model, which is the <robot> alone"
_CONTROLLED = "acts in a simulator, and is not part of the model"

_ON = ("true", "1")
_POSE = "@xyz @rpy @quat_xyzw"
_BUILT_BY_MUJOCO = "changes masses or inertias in MuJoCo, and is not read"

PLACES = {
    "robot": place(
        read="@name link* joint* drake:joint*=joint transmission*= gazebo* mujoco* loop* coupling* loop_joint*= "
        "drake:ball_constraint*=",
        idle="@version material sensor ros2_control isaac_sim_config drake:collision_filter_group group "
        "group_state disable_collisions virtual_joint end_effector passive_joint",
        warned={
            "origin": "the place of the robot in Gazebo, which is not read: the root link stands at the base",
            "plugin": f"a plugin {_CONTROLLED}",
            **{
                name: f"{name} {_ACTS}"
                for name in (
                    "constraint",
                    "joint_constraint",
                    "loop_constraint",
                    "drake:linear_bushing_rpy",
                    "drake:linear_spring_damper",
                    "drake:tendon_constraint",
                )
            },
        },
        refused=dict.fromkeys(("property", "macro", "include", "insert_block", "arg", "if", "unless", "call"), _XACRO),
    ),
    "link": place(
        read="@name inertial contact",
        idle="@type visual collision material sensor verbose self_collision_checking drake:visual",
        warned={
            "gravity": warning("the gravity of a link is not read: gravity acts on all links", *_ON),
        },
    ),
    "inertial": place(read="@name origin=pose mass inertia"),
    "pose": place(read=_POSE),
    "mass": place(read="@value"),
    "inertia": place(read="@ixx @ixy @ixz @iyy @iyz @izz"),
    "contact": place(
        idle="lateral_friction rolling_friction spinning_friction stiffness damping restitution contact_cfm "
        "contact_erp friction_anchor",
        warned={"inertia_scaling": warning("Bullet scales the inertia by it; here it is not scaled", "1", "1.0")},
    ),
    "joint": place(
        read="@name @type @independent origin=pose parent=end child=end axis limit dynamics mimic "
        "actuator*= drake:screw_thread_pitch=value",
        idle="calibration safety_controller sensor drake:controller_gains hardwareInterface",
        warned={"drake:mimic": "it follows another joint in Drake; here it moves on its own: give <mimic>"},
    ),
    "end": place(read="@link"),
    "axis": place(read="@xyz"),
    "limit": place(
        read="@lower @upper @velocity @effort",
        idle="@acceleration @deceleration @jerk @drake:acceleration",
    ),
    "dynamics": place(
        read="@damping @friction @armature @rotor_inertia",
        warned={
            "@stiffness": "a spring, which is left out: URDF does not say where it is slack; give stiffness and rest",
            "@spring_stiffness": "a spring, which is left out; give stiffness and rest in the model file",
            "@spring_reference": "of a spring, which is left out; give stiffness and rest in the model file",
        },
    ),
    "mimic": place(read="@joint @multiplier @offset"),
    "value": place(read="@value"),
    "loop": place(read="@name @type predecessor=loop_end successor=loop_end axis"),
    "loop_end": place(read="@link origin=pose"),
    "coupling": place(read="@name predecessor=end successor=end ratio=value"),
    "gazebo": place(
        read="",
        idle="@reference @version material visual collision sensor mu1 mu2 mu fdir1 kp kd maxVel minDepth maxContacts "
        "selfCollide self_collide laserRetro canonicalBody provideFeedback stopCfm stopErp stopKp stopKd fudgeFactor "
        "cfmDamping implicitSpringDamper preserveFixedJoint disableFixedJointLumping genTexCoord frame pose light "
        "particle_emitter allow_auto_disable",
        warned={
            "turnGravityOff": "a link without gravity in Gazebo; here gravity acts on all",
            "gravity": warning("of a link in Gazebo; here gravity acts on all", *_ON),
            "dampingFactor": "a resistance of the surrounding medium in Gazebo, which is left out",
            "velocity_decay": "a resistance of the surrounding medium in Gazebo, which is left out",
            "static": "the robot stands fast in Gazebo; here it moves",
            "kinematic": "a link that no force moves in Gazebo; here forces move it",
            "enable_wind": "wind acts on the link in Gazebo; here there is none",
            "springStiffness": "a spring in Gazebo, which is left out; give stiffness and rest in the model file",
            "springReference": "of a spring in Gazebo, which is left out",
            "initial_joint_position": "a pose in Gazebo, which is not read",
            "inertial": f"an inertial in <gazebo> {_OF_SDF}",
            "axis": f"an axis in <gazebo> {_OF_SDF}",
            "physics": warning(f"settings of a solver in <gazebo>: {_OF_SDF}"),
            "plugin": f"a plugin of Gazebo {_CONTROLLED}",
            "joint": "a joint of SDF is not part of the model; give a <loop> between its links",
            "link": f"a link of SDF {_OF_SDF}",
            "model": f"a model of SDF {_OF_SDF}",
            "include": f"a model of SDF {_OF_SDF}",
            "gripper": f"a gripper of SDF {_OF_SDF}",
            "battery": f"a battery of SDF {_OF_SDF}",
        },
    ),
    "mujoco": place(
        read="compiler", idle="visual asset size", warned={"option": warning(f"options of MuJoCo: {_OF_SDF}")}
    ),
    "compiler": place(
        idle="@strippath @discardvisual @fusestatic @meshdir @texturedir @assetdir @angle @eulerseq @convexhull "
        "@autolimits @usethread @coordinate @alignfree @saveinertial",
        warned={
            f"@{name}": warning(f"{name} {_BUILT_BY_MUJOCO}", *harmless)
            for name, harmless in {
                "balanceinertia": ("false",),
                "boundmass": ("0",),
                "boundinertia": ("0",),
                "settotalmass": ("-1", "0"),
                "inertiafromgeom": ("auto", "false"),
                "inertiagrouprange": ("0 5",),
            }.items()
        },
    ),
}

VOCABULARY = Vocabulary(PLACES)
