"""Names that a target language cannot take as they are."""

from __future__ import annotations

HOSTILE = [
    "arm", "Arm", "arm_", "_arm", "a__rm", "a_rm", "arm-1", "arm 1", "arm.1", "1arm", "Z", "ZZ", "Z5fz", "aZ2dz1",
    "int", "gamma", "sin", "restrict", "jac", "jac_arm", "adj1_arm", "fwd1_arm", "jac_adj1_arm", "arm_compute",
    "compute_arm", "compute", "arm_jac", "arm_compute_jac", "arm_impl", "mbs", "mbs_abi", "mbs_many", "casadi",
    "../../etc/passwd", "a/b", "a\\b", "*/ int main(){} /*", "a\nb", "a\0b", "ärm", "a\u0308rm", "机械臂", "🤖", "%s%n",
    "math", "Math", "m", "test", "all", "arm_check", "check", "arm_default", "default_parameters", "arm_semi",
    "$(reboot)", "`id`", '"; rm -rf /', "a" * 200, "a" * 199 + "b", "\ud800", "_", "__", " ",
]  # fmt: skip
