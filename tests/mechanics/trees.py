"""Trees in MJCF and URDF for the comparison with MuJoCo, as texts."""

BODY = '<geom type="box" size=".1 .05 .2" pos=".02 .03 .2" euler="10 20 30" density="800"/>'
FULL = '<inertial pos=".1 .02 .05" mass="1.5" fullinertia=".05 .06 .04 .01 -.008 .006"/>'


def mjcf(bodies, rest="", compiler="<compiler angle='degree'/>"):
    return f"<mujoco>{compiler}<worldbody>{bodies}</worldbody>{rest}</mujoco>"


def body(name, inside, pos="0 0 .5", euler="5 -10 20"):
    return f'<body name="{name}" pos="{pos}" euler="{euler}">{inside}</body>'


def link(name, mass="1.2"):
    tensor = 'ixx="0.03" iyy="0.04" izz="0.02" ixy="0.004" ixz="-0.003" iyz="0.002"'
    origin = '<origin xyz=".02 0 .1" rpy=".1 .2 0"/>'
    return f'<link name="{name}"><inertial>{origin}<mass value="{mass}"/><inertia {tensor}/></inertial></link>'


def joint(name, kind, parent, child, inside=""):
    ends = f'<parent link="{parent}"/><child link="{child}"/><origin xyz=".05 0 .3" rpy="0.3 0 .1"/>'
    return f'<joint name="{name}" type="{kind}">{ends}<axis xyz="0 .6 .8"/>{inside}</joint>'


HINGES = body(
    "upper",
    '<joint name="a" axis="0 1 0" damping=".4" armature=".3"/>'
    + BODY
    + body("lower", '<joint name="b" axis="1 .3 0" stiffness="7" springref="20" ref="15" pos=".02 0 -.1"/>' + FULL),
)
SLIDES = body(
    "cart",
    '<joint name="x" type="slide" axis="1 0 .2" stiffness="30" springref=".1" ref=".05" damping="2" armature=".7"/>'
    + BODY
    + body("pole", '<joint name="turn" axis="0 1 0"/>' + FULL),
)
BALLS = body(
    "one",
    '<joint name="p" type="ball" stiffness="5" damping=".2" armature=".1"/>'
    + FULL
    + body("two", '<joint name="q" type="ball" pos="0 .1 0"/>' + BODY),
)
FREE = body("base", "<freejoint name='root'/>" + FULL + body("arm", '<joint name="a" axis="0 1 1" armature=".2"/>' + BODY))
PLANAR = body(
    "torso",
    '<joint name="rootx" type="slide" axis="1 0 0" armature="1"/><joint name="rootz" type="slide" axis="0 0 1"/>'
    '<joint name="rooty" axis="0 1 0" pos="0 0 .1" damping=".1"/>'
    + BODY
    + body("leg", '<joint name="hip" axis="0 1 0" damping="1" armature=".05"/>' + FULL, euler="0 10 0"),
)
UNIVERSAL = body(
    "rod",
    '<joint name="h" axis="2 1 1" pos="0 0 .1" armature=".2" damping=".3"/>'
    '<joint name="k" axis="0.3 -1 1" pos="0 0 .1" stiffness="4" armature=".1"/>'
    + FULL
    + body("end", '<joint name="s" type="slide" axis="0 0 1"/><joint name="y" axis="0 1 0" armature=".4"/>' + BODY),
)
HIP = body(
    "pelvis",
    "<freejoint/>"
    + BODY
    + body(
        "thigh",
        '<joint name="hx" axis="1 0 0" armature=".2" damping=".5" stiffness="9" springref="10"/>'
        '<joint name="hz" axis="0 0 1" armature=".3" damping=".4" stiffness="8"/>'
        '<joint name="hy" axis="0 1 0" armature=".1" damping=".3" stiffness="7" ref="5"/>'
        + FULL
        + body("shin", '<joint name="knee" axis="0 -1 0" pos="0 0 .02"/>' + BODY),
    ),
)
POLAR = body(
    "boom",
    '<joint name="swing" axis="0 0 1" armature=".3"/>'
    '<joint name="reach" type="slide" axis="1 0 0" damping="3" armature=".6"/>'
    + BODY
    + body("fixed", FULL + body("tip", '<joint name="c" type="slide" axis="0 0 1"/><joint name="d" axis="0 0 1"/>' + FULL)),
)
MOTORS = (
    '<actuator><motor name="m" joint="a" gear="3"/><position name="p" joint="b" kp="5" kv=".3" ctrlrange="-.2 .2"/>'
    '<motor name="limited" joint="b" gear="2" forcerange="-1 1"/><velocity name="v" joint="a" kv=".7" gear="2"/>'
    '<general name="rotor" joint="a" gear="4" armature=".02" damping=".01" gainprm="2"/></actuator>'
)
TREES = {
    "two hinges, full inertia, springref and ref": (mjcf(HINGES), {}),
    "cart and pole": (mjcf(SLIDES), {}),
    "ball joints": (mjcf(BALLS), {}),
    "a free body with an arm": (mjcf(FREE), {}),
    "two slides and a hinge on one body": (mjcf(PLANAR), {}),
    "oblique universal, slide and hinge": (mjcf(UNIVERSAL), {}),
    "three hinges on one body": (mjcf(HIP), {}),
    "hinge and slide, fused body, cylinder": (mjcf(POLAR), {}),
    "motors and servos": (mjcf(HINGES, MOTORS), {"m": 0.5, "p": 0.7, "limited": -2.0, "v": 0.4, "rotor": 0.1}),
    "torque on a ball": (
        mjcf(BALLS, '<actuator><motor name="m" joint="q" gear="1 2 3"/></actuator>'),
        {"m": 0.8},
    ),
    "urdf with fixed joints": (
        "<robot name='r'>"
        + "".join(link(x) for x in "abcd")
        + "<link name='base'/><link name='tool'/>"
        + joint("j1", "continuous", "base", "a", '<dynamics damping="0.3" friction="0"/>')
        + joint("j2", "prismatic", "a", "b", '<limit lower="-1" upper="1" effort="9" velocity="1"/>')
        + joint("j3", "fixed", "b", "c")
        + joint("j4", "continuous", "c", "d")
        + joint("j5", "fixed", "d", "tool")
        + "</robot>",
        {},
    ),
}
