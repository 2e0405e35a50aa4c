"""Equalities of MJCF close a model as MuJoCo closes it, exactly."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from mbsgen.assembly import assemble
from mbsgen.errors import InputError
from mbsgen.expressions import FLOATS, Number, write
from mbsgen.expressions import evaluate as evaluate_expression
from mbsgen.formulations import closure, ports
from mbsgen.formulations.catalogue import FUNCTIONS
from mbsgen.formulations.reductions import NONE
from mbsgen.importing import Choices, Imported, import_model, write_imported
from mbsgen.model.changes.reduction import build_tree
from mbsgen.model.model import Follow, Joint
from mbsgen.model.reader import read_model
from mbsgen.model.tree import Cut, Tree
from mbsgen.tape.interpreter import evaluate
from tests.import_peers import MujocoPeer, State, strip_forces
from tests.loop_ends import place_ends

Array = NDArray[np.float64]
SOLID = '<inertial pos="0.1 -0.05 0.2" quat="0.9 0.1 -0.2 0.3" mass="1.5" diaginertia="0.02 0.03 0.025"/>'
ROUNDING = 1e-13
DIFFERENCES = 1e-7  # of central differences with steps of 1e-6

# Chains with anchors off the bodies' origins, references, a ball and a free body; sites on the world and on a body.
BODIES = f"""
<compiler angle="radian"/>
<worldbody>
  <site name="ground" pos="0.3 0.1 0.2" euler="0.1 0.2 0.3"/>
  <body name="a" pos="0.1 0.2 0.3" euler="0.3 0.2 0.1"><joint name="ja" axis="0 1 0" pos="0.05 0 0.1" ref="0.4"/>{SOLID}
    <body name="b" pos="0.3 0 0" euler="0.1 0.5 -0.3"><joint name="jb" axis="0 1 1"/>{SOLID}
      <joint name="jb2" type="slide" axis="1 0 0" ref="0.1"/><site name="sb" pos="0.1 0 0" euler="0.2 0.1 0"/>
      <body name="c" pos="0.1 0.2 0"><joint type="ball"/>{SOLID}</body>
    </body>
  </body>
  <body name="d" pos="-0.1 0 0.2" euler="0.5 0.2 0.1"><joint name="jd" type="slide"/>
    <joint name="jd2" axis="1 0 0"/>{SOLID}</body>
  <body name="f" pos="1 2 3" euler="0.5 0.2 0.1"><freejoint/>{SOLID}</body>
</worldbody>"""


def save(folder: Path, equalities: str, bodies: str = BODIES, more: str = "") -> Path:
    path = folder / "machine.xml"
    text = f'<mujoco model="machine">{bodies}\n<equality>\n{equalities}\n</equality>{more}</mujoco>\n'
    path.write_text(text, encoding="utf-8")
    return path


def notices(imported: Imported) -> str:
    return "\n".join(str(notice.without_folder()) for notice in imported.notices)


def find_joint(imported: Imported, name: str) -> Joint:
    joints = [joint for body in imported.model.bodies for joint in body.joints]
    return next(joint for joint in joints if joint.name == name)


class Peer(MujocoPeer):
    """MuJoCo's equalities beside its equations."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self.model.opt.jacobian = 0  # dense

    def residual(self) -> Array:
        """Compute the residuals of all equalities where the file's data are."""
        self._mujoco.mj_forward(self.model, self.data)
        return np.array(self.data.efc_pos)

    def close(self, q: Array) -> tuple[Array, Array]:
        """Compute the residuals of all equalities, and their Jacobian by our velocities."""
        self._place(q)
        self.data.qvel[:] = 0
        self._mujoco.mj_forward(self.model, self.data)
        J = np.array(self.data.efc_J).reshape(self.data.nefc, self.model.nv)
        return np.array(self.data.efc_pos), J @ self._rates(q)


def evaluate_closure(tree: Tree, q: Array) -> Array:
    return np.array(evaluate(closure.build(tree), {"q": list(q)})[ports.CLOSURE.name], float)


def draw(tree: Tree, seed: int) -> Array:
    return np.random.default_rng(seed).uniform(-1, 1, len(tree.joints))


POINTS = ('<connect body1="c" body2="d" anchor="0.1 0.2 0.3"/>', '<connect body1="b" anchor="0.1 0.2 0.3"/>')
POINTS += ('<connect site1="ground" site2="sb"/>', '<weld body1="a" body2="f" anchor="0 0.1 0.3" torquescale="0"/>')


@pytest.mark.parametrize("equality", POINTS)
def test_points_are_kept_together_as_in_mujoco(equality: str, tmp_path: Path) -> None:
    """In any pose: MuJoCo's residual is p1 - p2 in the world, of which h has the length, and so is its Jacobian."""
    path = save(tmp_path, equality)
    imported = import_model(path)
    (loop,) = imported.model.loops
    assert loop.cut is Cut.BALL
    tree, peer = build_tree(imported.model), Peer(path)
    for seed in range(2):
        q, direction = draw(tree, seed), draw(tree, seed + 9)
        residual, J = peer.close(q)
        np.testing.assert_allclose(find_gap(tree, q), -residual[:3], atol=ROUNDING * 10)
        assert np.linalg.norm(evaluate_closure(tree, q)) == pytest.approx(np.linalg.norm(residual[:3]), abs=1e-12)
        slope = (find_gap(tree, q + 1e-6 * direction) - find_gap(tree, q - 1e-6 * direction)) / 2e-6
        np.testing.assert_allclose(slope, -J[:3] @ direction, atol=DIFFERENCES)


def find_gap(tree: Tree, q: Array) -> Array:
    """Return p2 - p1 of the only loop, in the base frame."""
    ((p1, p2, _, _),) = place_ends(tree, q)
    return p2 - p1


FRAMES = ('<weld body1="f" body2="c" anchor="0.1 0 0.2"/>', '<weld site1="ground" site2="sb"/>', '<weld body1="d"/>')
FRAMES += ('<weld body1="f" body2="b" anchor="0.1 0 0.2" relpose="0.1 0.2 0.3 0.9 0.1 -0.2 0.3" torquescale="0.7"/>',)


@pytest.mark.parametrize("equality", FRAMES)
def test_frames_are_kept_together_as_in_mujoco(equality: str, tmp_path: Path) -> None:
    """In any pose: the same distance; of the angle between the frames, MuJoCo's residual is the sine of its half."""
    path = save(tmp_path, equality)
    (loop,) = (imported := import_model(path)).model.loops
    assert loop.cut is Cut.SOLID
    tree, peer = build_tree(imported.model), Peer(path)
    scale = float(peer.model.eq_data[0, 10])
    for seed in range(2):
        q = draw(tree, seed)
        residual, _ = peer.close(q)
        h = evaluate_closure(tree, q)
        assert np.linalg.norm(h[:3]) == pytest.approx(np.linalg.norm(residual[:3]), abs=ROUNDING * 10)
        cosine = 1 - 2 * (np.linalg.norm(residual[3:6]) / scale) ** 2
        assert find_cosine(tree, q) == pytest.approx(cosine, abs=ROUNDING * 10)


def find_cosine(tree: Tree, q: Array) -> float:
    """Return the cosine of the angle by which the frames of the only loop are turned against each other."""
    ((_, _, R1, R2),) = place_ends(tree, q)
    return float(np.trace(R1.T @ R2) - 1) / 2


LINKAGE = f"""
<compiler angle="radian"/>
<worldbody>
  <body name="a"><joint name="ja" axis="0 1 0"/>{SOLID}
    <body name="b" pos="0.3 0 0.1"><joint name="jb" axis="0 1 0.2"/>{SOLID}
      <body name="c" pos="0.1 0.2 0.2"><joint type="ball"/>{SOLID}</body></body></body>
  <body name="d" pos="0.6 0 0.1"><joint name="jd" axis="0.1 1 0"/>{SOLID}</body>
  <body name="e" pos="0.2 -0.4 0.1"><joint name="je" axis="1 0 0.3"/>{SOLID}</body>
</worldbody>"""
COUPLED = '<joint joint1="je" joint2="jb" polycoef="0 0.5 0.8 0 -0.2"/>'


def test_accelerations_are_those_of_mujocos_equations_solved_exactly(tmp_path: Path) -> None:
    """[M -J^T; J 0] [qdd; lam] = [Q - c; -Jd qd] by MuJoCo's M, c and J, at a closed pose with rates along it."""
    path = save(tmp_path, f'<connect body1="c" body2="d" anchor="0.2 0.1 0"/>{COUPLED}', LINKAGE)
    tree = assemble(build_tree(strip_forces(import_model(path).model)))
    peer = Peer(path)
    assert tree.closure is not None
    q, n = np.array(tree.closure.pose), len(tree.joints)
    residual, J = peer.close(q)
    assert np.abs(residual).max() < ROUNDING * 10
    rng = np.random.default_rng(0)
    qd, Q = np.linalg.svd(J)[2][len(J) :].T @ rng.uniform(-1, 1, n - len(J)), rng.uniform(-1, 1, n)
    near, far = ((peer.close(q + s * qd)[1] - peer.close(q - s * qd)[1]) @ qd / (2 * s) for s in (1e-4, 2e-4))
    bias = (4 * near - far) / 3
    mine = peer.compute(State(q, qd, np.zeros(n), Q))
    matrix = np.block([[mine["M"], -J.T], [J, np.zeros((len(J), len(J)))]])
    expected = np.linalg.solve(matrix, np.concatenate([Q - mine["c"], -bias]))[:n]
    found = evaluate(FUNCTIONS["exp1"].build(tree, NONE), {"q": list(q), "qd": list(qd), "u": list(Q)})["qdd"]
    np.testing.assert_allclose(np.array(found, float), expected, rtol=0, atol=1e-8 * np.abs(expected).max())


def test_joints_that_depend_on_others_meet_mujocos_equation(tmp_path: Path) -> None:
    """A linear equality makes a follower, exactly; any other one makes an equation, with the references of both."""
    path = save(
        tmp_path,
        '<joint name="gear" joint1="ja" joint2="jd" polycoef="0.1 2"/>'
        '<joint name="cam" joint1="jb" joint2="jb2" polycoef="0.1 2 0 0.5 -0.3"/><joint joint1="jd2" polycoef="0.1"/>',
    )
    imported = import_model(path)
    assert find_joint(imported, "ja").follows == Follow("jd", Number(2.0), Number(0.5))
    assert not find_joint(imported, "ja").actuated
    peer, rng = Peer(path), np.random.default_rng(0)
    data, model = peer.data, peer.model
    data.qpos[:3] = rng.uniform(-1, 1, 3)
    residual = peer.residual()
    ja, jb, jb2, jd, jd2 = (float(data.qpos[model.joint(name).qposadr[0]]) for name in ("ja", "jb", "jb2", "jd", "jd2"))
    assert residual[0] == pytest.approx(ja - 2 * jd - 0.5, abs=ROUNDING)
    values = {"jb": jb, "jb2": jb2, "jd2": jd2}
    found = [float(evaluate_expression(x.equation, values, FLOATS)) for x in imported.model.constraints]
    np.testing.assert_allclose(found, residual[1:3], atol=ROUNDING)
    assert dict(imported.model.assembly)["jb2"] == Number(0.1)


def test_the_undriven_joint_follows(tmp_path: Path) -> None:
    actuator = '<actuator><motor joint="ja"/></actuator>'
    path = save(tmp_path, '<joint joint1="ja" joint2="jd" polycoef="0.1 2"/>', more=actuator)
    assert find_joint(import_model(path), "jd").follows == Follow("ja", Number(0.5), Number(-0.25))
    both = actuator.replace("<motor", '<motor joint="jd"/><motor')
    imported = import_model(save(tmp_path, '<joint joint1="ja" joint2="jd" polycoef="0.1 2"/>', more=both))
    assert [write(x.equation) for x in imported.model.constraints] == ["ja - 2*jd - 0.5"]


def test_held_joints_enter_equations_as_numbers(tmp_path: Path) -> None:
    path = save(tmp_path, '<joint joint1="ja" joint2="jd" polycoef="0.1 2 1"/>')
    held = import_model(path, Choices(locked=(("jd", 0.5),)))
    assert [write(x.equation) for x in held.model.constraints] == ["ja - 1.75"]
    meeting = import_model(path, Choices(locked=(("jd", 0.5), ("ja", 1.75))))
    assert not meeting.model.constraints
    assert "the joints are held, and meet it" in notices(meeting)
    with pytest.raises(InputError, match=r"the joints are held, and 0\.25 is left"):
        import_model(path, Choices(locked=(("jd", 0.5), ("ja", 2.0))))


def test_joints_get_names_that_equations_can_have(tmp_path: Path) -> None:
    bodies = BODIES.replace('"ja"', '"left knee"').replace('"jd"', '"sin"')
    imported = import_model(save(tmp_path, '<joint joint1="left knee" joint2="sin" polycoef="0 2 1"/>', bodies))
    assert [write(x.equation) for x in imported.model.constraints] == ["left_knee - 2*q_sin - q_sin**2 - 0.4"]
    assert 'joint "left knee" is called "left_knee" in the model, as equations need it' in notices(imported)
    file = tmp_path / "machine.yaml"
    file.write_text(write_imported(imported), encoding="utf-8")
    assert read_model(file) == imported.model


def test_what_is_soft_inactive_or_unknown_is_told(tmp_path: Path) -> None:
    """Each by its line; only what changes the motion is a warning."""
    defaults = '<default><equality solref="0.01 1"/><default class="off"><equality active="false"/></default></default>'
    path = save(
        tmp_path,
        '<connect name="k" body1="c" body2="d" anchor="0 0 0" solimp="0.9 0.95 0.001"/>'
        '<connect class="off" body1="a" body2="f" anchor="0 0 0"/><tendon tendon1="t"/><flex flex="g"/>',
        defaults + BODIES,
    )
    imported = import_model(path)
    (loop,) = imported.model.loops
    assert loop.name == "k"
    told = notices(imported)
    for text in (
        "connect[k]: solref and solimp: left out, since it is exact here",
        "equality/connect: it is not active in the file: left out",
        "equality/tendon: warning: tendon (equality) is not part of a model",
        "equality/flex: warning: flex (equality) is not part of a model",
        "equalities are exact here, and soft in MuJoCo",
    ):
        assert text in told
    disabled = '<option><flag equality="disable"/></option>'
    imported = import_model(save(tmp_path, POINTS[0], disabled + BODIES))
    assert not imported.model.loops
    assert "the file disables its equalities" in notices(imported)


def test_a_closed_model_is_written_and_read_as_the_same(tmp_path: Path) -> None:
    """With its loops, its equations, and the pose of the file: a free body is where the file puts it."""
    equalities = f'{POINTS[0]}{FRAMES[-1]}<joint joint1="jb" joint2="jd2" polycoef="0.1 2 0 0.5 -0.3"/>'
    imported = import_model(save(tmp_path, equalities))
    file = tmp_path / "machine.yaml"
    file.write_text(write_imported(imported), encoding="utf-8")
    assert read_model(file) == imported.model
    assert {"jb2", "f.x", "f.rz"} < dict(imported.model.assembly).keys()


@pytest.mark.parametrize(
    ("equality", "text"),
    [
        ('<connect body2="d" anchor="0 0 0"/>', "a connect without body1"),
        ('<connect body1="a" body2="d"/>', "a connect without an anchor"),
        ('<connect body1="a" body2="dd" anchor="0 0 0"/>', 'there is no body "dd"; did you mean "d"?'),
        ('<connect site1="ground" anchor="0 0 0"/>', "there is no site"),
        ('<weld body1="a" body2="a"/>', 'a loop between "a" and itself'),
        ('<weld body1="a" body2="d" relpose="0 0 0 x 0 0 0"/>', "relpose is"),
        ('<weld body1="a" body2="d" anchor="0 0"/>', "anchor has 2 numbers"),
        ('<weld body1="a" body2="d" active="maybe"/>', "active is"),
        ('<weld class="none" body1="a" body2="d"/>', "there is no default class"),
        ('<joint joint2="ja"/>', "a joint equality without joint1"),
        ('<joint joint1="ja" joint2="ja" polycoef="0 2"/>', '"ja" depends on itself'),
        ('<joint joint1="ja" joint2="jx"/>', 'there is no hinge or slide "jx"'),
        ('<joint joint1="ja" joint2="jd" polycoef="0 1 2 3 4 5"/>', "polycoef has 6 numbers"),
        ('<joint joint1="ja" joint2="jd" polycoef="0 nan"/>', "polycoef is"),
        (POINTS[0] * 2, "the same loop as line 16"),
    ],
)
def test_faulty_equalities(equality: str, text: str, tmp_path: Path) -> None:
    with pytest.raises(InputError) as caught:
        import_model(save(tmp_path, equality))
    assert text in str(caught.value)
    assert "machine.xml:16: mujoco/equality/" in str(caught.value)
