"""The elements and attributes that the published schemas of SDF and URDF list at each place of their vocabularies.

SDF: the descriptions of versions 1.0 to 1.12 (gazebosim/sdformat, sdf/*/*.sdf), all versions together. URDF: urdf.xsd
of urdfdom, with its versions 1.1 and 1.2.
"""

from __future__ import annotations

SDF = {
    "sdf": "@version actor light model world",
    "world": "@name actor atmosphere audio frame gravity gui include joint light magnetic_field model physics plugin "
    "population road scene spherical_coordinates state wind",
    "physics": "@default @name @type @update_rate bullet dart gravity magnetic_field max_contacts max_step_size ode "
    "real_time_factor real_time_update_rate simbody update_rate",
    "model": "@canonical_link @name @placement_frame @static allow_auto_disable enable_wind frame gripper include "
    "joint link model model_state origin plugin pose self_collide static",
    "frame": "@attached_to @name pose",
    "pose": "@degrees @frame @relative_to @rotation_format",
    "link": "@gravity @kinematic @name @self_collide audio_sink audio_source battery collision damping enable_wind "
    "frame gravity inertial kinematic light must_be_base_link origin particle_emitter pose projector self_collide "
    "sensor velocity_decay visual",
    "inertial": "@auto @density @mass auto_inertia_params density fluid_added_mass frame inertia mass origin pose",
    "inertia": "@ixx @ixy @ixz @iyy @iyz @izz ixx ixy ixz iyy iyz izz",
    "joint": "@name @type axis axis2 child frame gearbox_ratio gearbox_reference_body origin parent physics pose "
    "screw_thread_pitch sensor thread_pitch",
    "end": "@link",
    "axis": "@xyz dynamics initial_position limit mimic use_parent_model_frame xyz",
    "direction": "@expressed_in",
    "dynamics": "@damping @friction damping friction spring_reference spring_stiffness",
    "limit": "@effort @lower @upper @velocity dissipation effort lower stiffness upper velocity",
    "mimic": "@axis @joint multiplier offset reference",
    "solver": "ode provide_feedback simbody",
    "simbody": "must_be_loop_joint",
    "ode": "bounce cfm cfm_damping erp fudge_factor implicit_spring_damper limit max_force provide_feedback "
    "suspension velocity",
}

URDF = {
    "robot": "@name @version joint link material transmission",
    "link": "@name @type inertial visual collision",
    "inertial": "origin mass inertia",
    "pose": "@xyz @rpy @quat_xyzw",
    "mass": "@value",
    "inertia": "@ixx @ixy @ixz @iyy @iyz @izz",
    "joint": "@name @type origin parent child axis calibration dynamics limit safety_controller mimic",
    "end": "@link",
    "axis": "@xyz",
    "dynamics": "@damping @friction",
    "limit": "@lower @upper @effort @velocity @acceleration @deceleration @jerk",
    "mimic": "@joint @multiplier @offset",
}

SDF_FILE = """<sdf version="1.6"><world name="lab">
  <gravity>0.5 0 -9</gravity><physics/>
  <model name="top"><pose>0.1 0.2 0.3 0.1 0.2 0.3</pose>
    <frame name="seat" attached_to="a"><pose>0.1 0 0.2 0.3 0 0</pose></frame>
    <link name="a"><pose relative_to="__model__" degrees="false" rotation_format="euler_rpy">0 0.1 0 0.4 0 0.1</pose>
      <inertial auto="false"><pose>0.1 0.2 0.3 0.1 0 0</pose><mass>2</mass><inertia>
        <ixx>0.2</ixx><iyy>0.3</iyy><izz>0.4</izz><ixy>0.01</ixy><ixz>0.02</ixz><iyz>0.03</iyz></inertia></inertial>
    </link>
    <link name="b"><pose>0.3 0 0 0 0.2 0</pose></link>
    <link name="c"><pose>0.6 0 0 0 0.2 0.1</pose></link>
    <link name="d"><pose>0.9 0 0 0 0.2 0.1</pose></link>
    <link name="e"><pose>1.9 0 0 0 0.2 0.1</pose></link>
    <model name="inner" canonical_link="g" placement_frame="g"><static>false</static><pose>0 1 0 0 0 0</pose>
      <link name="f"><pose>0.1 0.2 0.3 0.1 0 0</pose></link><link name="g"><pose>0.3 0 1 0 0 0.2</pose></link></model>
    <joint name="ja" type="revolute"><parent>world</parent><child>a</child><pose>0.1 0 0.1 0.2 0 0</pose>
      <axis><xyz expressed_in="seat">0 0.6 0.8</xyz>
        <dynamics><damping>0.2</damping><friction>0.3</friction><spring_reference>0.1</spring_reference>
          <spring_stiffness>3</spring_stiffness></dynamics>
        <limit><lower>-1</lower><upper>1</upper><effort>4</effort><velocity>5</velocity></limit></axis></joint>
    <joint name="jb" type="screw"><parent>a</parent><child>b</child><screw_thread_pitch>0.2</screw_thread_pitch>
      <axis><xyz>0 0.6 0.8</xyz><use_parent_model_frame>true</use_parent_model_frame></axis></joint>
    <joint name="jc" type="screw"><parent>b</parent><child>c</child><thread_pitch>-3</thread_pitch>
      <axis><xyz>0 0.6 0.8</xyz></axis></joint>
    <joint name="jd" type="revolute"><parent>c</parent><child>d</child><axis><xyz>0 0.6 0.8</xyz>
      <mimic joint="ja" axis="axis"><multiplier>2</multiplier><offset>0.1</offset><reference>0.2</reference></mimic>
      </axis></joint>
    <joint name="pin" type="ball"><parent>a</parent><child>e</child>
      <physics><simbody><must_be_loop_joint>false</must_be_loop_joint></simbody><ode><erp>0.2</erp></ode></physics>
    </joint>
    <joint name="je" type="universal"><parent>d</parent><child>e</child><axis><xyz>1 0 0</xyz></axis>
      <axis2><xyz>0 0.6 0.8</xyz></axis2></joint>
    <joint name="jf" type="revolute"><parent>e</parent><child>inner</child><axis><xyz>0 1 0</xyz></axis></joint>
  </model></world></sdf>
"""

URDF_FILE = """<robot name="machine" version="1.1">
  <link name="a"/>
  <link name="b"><inertial><origin xyz="0.1 0.2 0.3" rpy="0.1 0.2 0.3"/><mass value="2"/>
    <inertia ixx="0.2" iyy="0.3" izz="0.4" ixy="0.01" ixz="0.02" iyz="0.03"/></inertial></link>
  <link name="c"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>
    <contact><inertia_scaling value="1"/></contact></link>
  <link name="d"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="e"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="jb" type="revolute"><origin xyz="0.2 0 0" quat_xyzw="0 0 0.6 0.8"/><parent link="a"/><child link="b"/>
    <axis xyz="0 0.6 0.8"/><limit lower="-1" upper="2" velocity="3" effort="4"/>
    <dynamics damping="0.1" friction="0.2" armature="0.3" rotor_inertia="0.4"/></joint>
  <joint name="jc" type="continuous" independent="false"><origin xyz="0.2 0 0" rpy="0.1 0.2 0.3"/><parent link="b"/>
    <child link="c"/></joint>
  <joint name="jd" type="prismatic"><parent link="b"/><child link="d"/><axis xyz="0 0.6 0.8"/>
    <mimic joint="jb" multiplier="0.4" offset="0.1"/></joint>
  <drake:joint name="je" type="screw"><parent link="d"/><child link="e"/><axis xyz="0 0.6 0.8"/>
    <drake:screw_thread_pitch value="0.3"/></drake:joint>
  <coupling name="gear"><predecessor link="c"/><successor link="e"/><ratio value="2"/></coupling>
</robot>
"""
