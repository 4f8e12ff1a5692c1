"""The GCR14-1400 as URDF: its table is published (C Table 1), its shape is not.

The capsules are estimates of ours for an arm of 14 kg payload: tubes of 0.11 to 0.16 m diameter,
the upper arm 0.16 m beside the shoulder, the forearm beside that, so that the wrist comes out at
the table's d4. The velocity limit is an estimate too. `models/gcr14_1400.urdf` is what `urdf`
returns; a test compares them.
"""

from math import pi

from skinplan.robot.dh import GCR14_1400, Capsule, write_urdf

JOINTS = (
    "shoulder_pan_joint",
    "shoulder_lift_joint",
    "elbow_joint",
    "wrist_1_joint",
    "wrist_2_joint",
    "wrist_3_joint",
)
LINKS = (
    "arm_base",
    "shoulder_link",
    "upper_arm_link",
    "forearm_link",
    "wrist_1_link",
    "wrist_2_link",
    "wrist_3_link",
)
VELOCITY_RAD_S = pi
BODIES = {
    "arm_base": (Capsule((0.0, 0.0, 0.06), (0.0, 0.0, 0.08), 0.08),),
    "shoulder_link": (
        Capsule((0.0, 0.0, -0.03), (0.0, 0.0, 0.03), 0.08),
        Capsule((0.0, 0.0, 0.0), (0.0, 0.07, 0.0), 0.08),
    ),
    "upper_arm_link": (
        Capsule((0.0, 0.0, 0.14), (0.0, 0.0, 0.18), 0.075),
        Capsule((0.0, 0.0, 0.16), (0.65, 0.0, 0.16), 0.07),
        Capsule((0.65, 0.0, 0.14), (0.65, 0.0, 0.18), 0.075),
    ),
    "forearm_link": (
        Capsule((0.0, 0.0, 0.005), (0.0, 0.0, 0.045), 0.065),
        Capsule((0.0, 0.0, 0.025), (0.6125, 0.0, 0.025), 0.055),
        Capsule((0.6125, 0.0, 0.0), (0.6125, 0.0, 0.07), 0.055),
    ),
    "wrist_1_link": (
        Capsule((0.0, 0.0, -0.02), (0.0, 0.0, 0.02), 0.055),
        Capsule((0.0, -0.06, 0.0), (0.0, 0.0, 0.0), 0.05),
    ),
    "wrist_2_link": (
        Capsule((0.0, 0.0, -0.02), (0.0, 0.0, 0.02), 0.05),
        Capsule((0.0, 0.0, 0.0), (0.0, 0.05, 0.0), 0.05),
    ),
    "wrist_3_link": (Capsule((0.0, 0.0, -0.05), (0.0, 0.0, -0.02), 0.045),),
}
_REMARK = (
    "SIASUN GCR14-1400 from its published modified Denavit-Hartenberg table; joint positions are\n"
    "     the table's theta. Capsules and velocity limits are estimates. Made by\n"
    "     skinplan.robot.gcr14_1400."
)


def urdf() -> str:
    """Returns the text of ``models/gcr14_1400.urdf``."""
    return write_urdf(GCR14_1400, JOINTS, LINKS, BODIES, VELOCITY_RAD_S, _REMARK)
