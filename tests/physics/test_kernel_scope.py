"""A kernel computes all of a robot's file, or both decline it: each feature of MJCF in turn.

A file with one more feature is completed, or refused in one line (robot_contract.py), or declined with a
reason that names the feature, or a control step of the kernel that takes it is that of C MuJoCo.
"""

import copy
from types import SimpleNamespace

import jax
import mujoco
import numpy as np
import pytest
from mujoco import mjx

from dynappo import config as config_lib
from dynappo.description import contacts as contacts_lib
from dynappo.description import robot as robot_lib
from dynappo.description import robot_contract
from dynappo.physics import engine as engine_lib
from dynappo.physics import engine_contract
from dynappo.physics.warp import scope
from dynappo.program import build, devices

pytest.importorskip("warp")

import other_robots  # noqa: E402
from kernel_case import ROBOTS, Case, drive  # noqa: E402

from dynappo.physics.warp import general, quadruped, tree  # noqa: E402

close = np.testing.assert_allclose
STEPS = 4  # physics steps of a control step
T, J = mujoco.mjtObj, "FL_thigh_joint"
SPEC = robot_lib.load("go1").xml
EULER = mujoco.mjtIntegrator.mjINT_EULER


def put(kind, name="", /, **values):
    """`spec -> None` that sets attributes of the joint, geom, body or motor `name`, or of the options."""

    def change(spec):
        of = spec.option if kind == "option" else getattr(spec, kind)(name)
        for key, value in values.items():
            setattr(of, key, value)

    return change


def everywhere(kind, **values):
    """As `put`, of all items of a kind behind the first, the base's or the floor's."""

    def change(spec):
        for item in getattr(spec, kind)[1:]:
            for key, value in values.items():
                setattr(item, key, value)

    return change


def equality(kind, one, other, objtype=T.mjOBJ_BODY, **values):
    def change(spec):
        if kind == mujoco.mjtEq.mjEQ_TENDON:
            tendon(stiffness=0)(spec)
        spec.add_equality(type=kind, objtype=objtype, name1=one, name2=other, **values)

    return change


def tendon(**values):
    """A fixed tendon over two joints of a leg."""

    def change(spec):
        made = spec.add_tendon(name="tendon", **values)
        made.wrap_joint("FL_thigh_joint", 1)
        made.wrap_joint("FL_calf_joint", 0.5)

    return change


def spatial(spec):
    spec.body("FL_calf").add_site(name="low")
    made = spec.add_tendon(name="rope", stiffness=[1000, 0, 0], springlength=[0.1, 0.1])
    made.wrap_site("imu")
    made.wrap_site("low")


def pair(one, other, **values):
    return lambda spec: spec.add_pair(geomname1=one, geomname2=other, **values)


def exclude(one, other):
    return lambda spec: spec.add_exclude(bodyname1=one, bodyname2=other)


def motor(**values):
    return put("actuator", J, **values)


def both(*changes):
    def change(spec):
        for one in changes:
            one(spec)

    return change


def sensors(spec):
    for kind in ("ACCELEROMETER", "GYRO", "FORCE", "TOUCH", "MAGNETOMETER"):
        spec.add_sensor(
            name=kind,
            type=getattr(mujoco.mjtSensor, f"mjSENS_{kind}"),
            objtype=T.mjOBJ_SITE,
            objname="imu",
            cutoff=0.1,
            noise=1,
        )


def xml(*pairs):
    """`spec -> text` of what MjSpec cannot add."""

    def change(spec):
        text = spec.to_xml()
        for old, new in pairs:
            assert old in text
            text = text.replace(old, new, 1)
        return text

    return change


def ball(spec):
    """A second thing in the world."""
    body = spec.worldbody.add_body(name="ball", pos=[2, 0, 1], mocap=True)
    body.add_geom(size=[0.1, 0, 0], contype=0, conaffinity=0)


def hfield(spec):
    spec.add_hfield(name="hills", nrow=2, ncol=2, size=[1, 1, 1, 1], userdata=np.zeros(4))
    spec.worldbody.add_geom(
        name="hills",
        type=mujoco.mjtGeom.mjGEOM_HFIELD,
        hfieldname="hills",
        contype=0,
        conaffinity=1,
    )


def notes(spec):
    """What only a person reads, or a program."""
    spec.nuserdata, spec.nuser_body, spec.nkey = 3, 2, 4
    spec.add_numeric(name="numbers", size=2, data=[1, 2])
    spec.add_text(name="text", data="text")
    spec.add_key(name="other", qpos=np.ones(19), qvel=np.ones(18))
    spec.body("FL_calf").add_camera(name="eye")
    spec.body("FL_calf").add_light(name="lamp")
    spec.body("trunk").userdata = [1, 2]


def mesh(spec):
    """A shape that touches nothing."""
    spec.add_mesh(name="wedge", uservert=[0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1])
    spec.body("trunk").add_geom(
        type=mujoco.mjtGeom.mjGEOM_MESH, meshname="wedge", contype=0, conaffinity=0, group=1
    )


def motors(kind, *values, ctrlrange=(0, 0), **named):
    """All motors as MjSpec's shortcut `kind` makes them."""

    def change(spec):
        for one in spec.actuators:
            one.ctrlrange = ctrlrange
            getattr(one, f"set_to_{kind}")(*values, **named)

    return change


def flag(kind, *names):
    def change(spec):
        bits = [getattr(mujoco, f"mjt{kind}Bit").__members__[f"mj{name}"] for name in names]
        setattr(spec.option, f"{kind.lower()}flags", int(sum(bits)))

    return change


FOOT, HIP, THIGH, CALF = "FL_foot", "FL_hip", "FL_thigh", "FL_calf"
MOTORS = "one motor a joint"
REFUSED = {  # complete.py, robot_contract.py, or MuJoCo's compiler
    "a plugin": (
        xml(
            (
                "<worldbody>",
                '<extension><plugin plugin="mujoco.elasticity.cable"><instance name="cable"><config '
                'key="twist" value="1e6"/></instance></plugin></extension><worldbody>',
            ),
            ('<camera name="track"', '<plugin instance="cable"/><camera name="track"'),
        ),
        "no plugins",
    ),
    "a flex": (
        xml(
            (
                "</worldbody>",
                '</worldbody><deformable><flex name="rope" dim="1" body="FL_calf FR_calf" '
                'element="0 1" radius="0.01"/></deformable>',
            )
        ),
        "rigid bodies only",
    ),
    "a slide joint": (put("joint", J, type=mujoco.mjtJoint.mjJNT_SLIDE), "hinge joints"),
    "a ball joint": (
        put("joint", J, type=mujoco.mjtJoint.mjJNT_BALL, range=[0, 1]),
        "hinge joints",
    ),
}
COMPLETED = {  # complete.py: then it is a robot that the kernel computes
    "a mocap body": (ball, "the scene is left out: ball"),
    "a height field": (hfield, "the scene is left out: hills"),
    "a shape in the world": (
        lambda spec: spec.worldbody.add_geom(name="box", size=[1, 1, 1], pos=[0, 0, 3], contype=0),
        "the scene is left out: box",
    ),
    "a second floor": (
        lambda spec: spec.worldbody.add_geom(
            name="second", type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0, 0, 1], conaffinity=0
        ),
        "the scene is left out: second",
    ),
    "parts that collide": (put("geom", "FL_calf", contype=1), "not one another"),
    "position servos": (motors("position", 20), MOTORS),
    "velocity servos": (motors("velocity", 2), MOTORS),
    "dampers": (motors("damper", 1, ctrlrange=[0, 1]), MOTORS),
    "cylinders": (motors("cylinder", 0.1, 0, area=1), MOTORS),
    "muscles": (motors("muscle", tausmooth=0, ctrlrange=(0, 1)), MOTORS),
    "DC motors": (motors("dcmotor", [1, 1], 1.0), MOTORS),
    "adhesion": (
        lambda spec: spec.add_actuator(
            name="sticky",
            target=CALF,
            trntype=mujoco.mjtTrn.mjTRN_BODY,
            ctrlrange=[0, 1],
        ).set_to_adhesion(1),
        MOTORS,
    ),
    "a delayed motor": (motor(delay=0.01, nsample=3), MOTORS),
    "a delayed sensor": (
        lambda spec: spec.add_sensor(
            type=mujoco.mjtSensor.mjSENS_GYRO,
            objtype=T.mjOBJ_SITE,
            objname="imu",
            delay=0.01,
            nsample=3,
        ),
        "",
    ),
    "a filtered motor": (
        motor(dyntype=mujoco.mjtDyn.mjDYN_FILTER, dynprm=[1, *[0] * 9]),
        MOTORS,
    ),
    "a disabled group of motors": (
        both(motor(group=3), put("option", disableactuator=8)),
        MOTORS,
    ),
    "a motor with damping": (motor(damping=[1, 0, 0]), MOTORS),
    "a motor with armature": (motor(armature=0.1), MOTORS),
    "a gear of 9": (motor(gear=[9, 0, 0, 0, 0, 0]), MOTORS),
    "a bounded motor": (motor(ctrllimited=1, ctrlrange=[-1, 1]), MOTORS),
    "a bounded joint torque": (
        put("joint", J, actfrclimited=1, actfrcrange=[-1, 1]),
        MOTORS,
    ),
    "a sloping floor": (put("geom", "floor", quat=[1, 0.1, 0, 0]), "level, at height 0"),
    "torsional friction": (put("geom", FOOT, condim=4), "condim 3"),
    "rolling friction": (put("geom", FOOT, condim=6), "condim 3"),
    "feet of the floor's priority": (put("geom", FOOT, priority=0), "priority 1"),
    "a pair with the floor": (pair(CALF, "floor"), ""),
    "a pair with a foot": (pair(FOOT, "floor", condim=3), ""),
}
EQ = mujoco.mjtEq
DECLINED = {
    "connect": (equality(EQ.mjEQ_CONNECT, CALF, "FR_calf"), "equality"),
    "weld": (equality(EQ.mjEQ_WELD, CALF, "FR_calf"), "equality"),
    "joint equality": (
        equality(EQ.mjEQ_JOINT, J, "FR_thigh_joint", T.mjOBJ_JOINT),
        "equality",
    ),
    "tendon equality": (equality(EQ.mjEQ_TENDON, "tendon", "", T.mjOBJ_TENDON), "equality"),
    "an equality that is off": (
        equality(EQ.mjEQ_WELD, CALF, "FR_calf", active=False),
        "equality",
    ),
    "a tendon's spring": (tendon(stiffness=[100, 0, 0], springlength=[0, 0]), "tendons"),
    "a tendon's damping": (tendon(damping=[2, 0, 0]), "tendons"),
    "a tendon's dry friction": (tendon(frictionloss=2), "tendons"),
    "a tendon's limit": (tendon(limited=1, range=[-0.1, 0.1]), "tendons"),
    "a tendon's armature": (tendon(armature=0.1), "tendons"),
    "a spatial tendon": (spatial, "tendons"),
    "a pair of parts": (pair(CALF, "FR_calf"), "contact pairs"),
    "an exclude of the floor": (exclude("world", CALF), "exclude"),
    "a motor with nonlinear damping": (motor(damping=[0, 1, 0]), "nonlinear damping"),
    "a spring": (put("joint", J, stiffness=[40, 0, 0], springref=0.3), "springs"),
    "a nonlinear spring": (put("joint", J, stiffness=[0, 5, 0]), "springs"),
    "nonlinear damping": (put("joint", J, damping=[0, 1, 0]), "damping"),
    "cubic damping": (put("joint", J, damping=[0, 0, 1]), "damping"),
    "damping of the base": (put("joint", "root", damping=[1, 0, 0]), "damping of the base"),
    "dry friction": (put("joint", J, frictionloss=0.5), "dry friction"),
    "a joint's margin": (put("joint", J, margin=0.1), "margins"),
    "a foot's margin": (put("geom", FOOT, margin=0.01), "margins"),
    "the floor's margin": (put("geom", "floor", margin=0.01), "margins"),
    "a foot's gap": (put("geom", FOOT, margin=0.01, gap=0.01), "margins"),
    "a gap without a margin": (put("geom", FOOT, gap=0.01), "gaps"),
    "gravity compensation": (put("body", "trunk", gravcomp=1), "gravity compensation"),
    "compensation by motors": (
        both(put("joint", J, actgravcomp=True), put("body", THIGH, gravcomp=1)),
        "gravity compensation",
    ),
    "air": (put("option", density=1.2), "air or water"),
    "honey": (put("option", viscosity=1), "air or water"),
    "wind": (put("option", density=1.2, wind=[5, 0, 0]), "air or water"),
    "a foot shaped for fluids": (put("geom", FOOT, fluid_ellipsoid=1), "geom_fluid"),
    "gravity aslant": (put("option", gravity=[1, 0, -9.81]), "gravity"),
    "an elliptic cone": (put("option", cone=mujoco.mjtCone.mjCONE_ELLIPTIC), "cone"),
    "noslip": (put("option", noslip_iterations=3), "noslip"),
    "another solver": (put("option", solver=mujoco.mjtSolver.mjSOL_CG), "solver"),
    "frictionless feet": (put("geom", FOOT, condim=1), "condim"),
    "a sticky foot": (put("geom", FOOT, adhesion=5), "adhesion"),
    "a conveyor belt": (put("geom", "floor", surfacevel=[1, 0, 0, 0, 0, 0]), "moving surfaces"),
    "a foot's solref as stiffness": (put("geom", FOOT, solref=[-1000, -10]), "solref"),
    "a joint's solref as stiffness": (put("joint", J, solref_limit=[-1000, -10]), "solref"),
    "a gear that the gain undoes": (
        motor(gear=[2, 0, 0, 0, 0, 0], gainprm=[0.5, *[0] * 9]),
        "a gear",
    ),
    **{
        f"integrator {name[6:]}": (put("option", integrator=value), "integrator")
        for name, value in mujoco.mjtIntegrator.__members__.items()
        if name != "mjINT_EULER"
    },
    **{
        f"flag {name[2:]}": (flag(kind, name[2:]), "flags")
        for kind in ("Disable", "Enable")
        for name, value in getattr(mujoco, f"mjt{kind}Bit").__members__.items()
        if not name.startswith("mjN")
        and name != "mjENBL_IPC"  # of one integrator
        and value not in robot_contract.NEEDED.values()
    },
}
# what only the kernel of trees computes, and how the kernel of quadrupeds names it
IN_TREES = {
    "a joint's ref": (put("joint", J, ref=0.1), "ref"),
    "a joint beside its body's origin": (put("joint", J, pos=[0, 0.1, 0]), "link's origin"),
    "a turned body": (put("body", THIGH, quat=[1, 0.1, 0, 0]), "turned frames"),
    "a joint without a range": (put("joint", J, limited=0), "without a range"),
    "a foot that is a box": (
        put("geom", FOOT, type=mujoco.mjtGeom.mjGEOM_BOX, size=[0.02, 0.02, 0.02]),
        "no spheres",
    ),
    "a foot of two shapes": (
        lambda spec: spec.body(CALF).add_geom(
            name="FL_foot2",
            size=[0.02, 0, 0],
            pos=[0.01, 0, -0.2],
            conaffinity=1,
            contype=0,
            priority=1,
        ),
        "other limbs",
    ),
    "armature of the base": (put("joint", "root", armature=0.1), "armature of the base"),
}
COMPUTED = {
    "nothing": both(),
    "damping": everywhere("joints", damping=[0.4, 0, 0]),
    "armature": put("joint", J, armature=0.2),
    "joint ranges": put("joint", J, range=[0.7, 0.81]),
    "a joint's solref and solimp": put(
        "joint",
        J,
        range=[0.7, 0.81],
        solref_limit=[0.03, 0.7],
        solimp_limit=[0.5, 0.99, 0.2, 0.3, 3],
    ),
    "a foot's solref and solimp": put(
        "geom", FOOT, solref=[0.03, 0.7], solimp=[0.5, 0.99, 0.2, 0.3, 3]
    ),
    "a stiff foot": put("geom", FOOT, solref=[0.001, 1]),  # less than two steps
    "a constant impedance": put("geom", FOOT, solimp=[0.8, 0.8, 0.01, 0.5, 2]),
    "friction": put("geom", FOOT, friction=[1.3, 0.5, 0.5]),
    "another foot": put("geom", FOOT, size=[0.03, 0, 0], pos=[0.01, 0.01, -0.2], quat=[1, 1, 0, 0]),
    "impratio": put("option", impratio=10),
    "the moon": put("option", gravity=[0, 0, -1.6]),
    "another step": put("option", timestep=0.002),
    "the floor's contact": put(
        "geom",
        "floor",
        friction=[2, 1, 1],
        solref=[0.1, 1],
        solimp=[0.1, 0.2, 0.1, 0.5, 2],
        condim=6,
        solmix=9,
    ),
    "a foot's solmix": put("geom", FOOT, solmix=9, priority=7),
    "a floor turned and moved": put("geom", "floor", quat=[1, 0, 0, 0.4], pos=[1, 2, 0]),
    "a base elsewhere": put("body", "trunk", pos=[1, 2, 3]),
    "a turned base": put("body", "trunk", quat=[1, 0.2, 0.3, 0.4]),
    "inertia aslant": both(
        put("body", "trunk", fullinertia=[0.02, 0.06, 0.07, 0.01, 0.004, -0.003]),
        put("body", THIGH, ipos=[0.01, 0.02, 0.03]),
    ),
    "axes aslant": put("joint", J, axis=[0.1, 1, 0.2]),
    "longer legs": put("body", CALF, pos=[0.004, 0.003, -0.22]),
    "excludes of links": both(exclude("trunk", HIP), exclude(HIP, CALF)),
    "springref without a spring": put("joint", J, springref=0.4),
    "friction's solref without dry friction": put("joint", J, solref_friction=[0.1, 2]),
    "sensors": sensors,
    "notes, keys, cameras": notes,
    "a mesh that touches nothing": mesh,
    "names": put("body", CALF, name="lower_leg"),
    "wind without air": put("option", wind=[5, 0, 0]),
    "magnetic": put("option", magnetic=[1, 0, 0]),
    "what overrides, without the flag": put("option", o_margin=1, o_solref=[1, 1]),
    "numbers of convex collisions": put("option", ccd_iterations=3, sdf_iterations=3),
    "a dense Jacobian": put("option", jacobian=mujoco.mjtJacobian.mjJAC_DENSE),
    "groups": both(motor(group=3), put("geom", FOOT, group=4), put("joint", J, group=2)),
}


def load(change, tmp_path):
    """Go1 with a change, as the file of somebody else."""
    spec = mujoco.MjSpec.from_file(str(SPEC))
    text = change(spec)
    path = tmp_path / "mine.xml"
    path.write_text(text if isinstance(text, str) else spec.to_xml())
    return robot_lib.load_xml(path)


def declines(case):
    return scope.declines(case.model, case.robot.feet)


def kernel(case, every_substep=False):
    return scope.kernel(case.model, case.robot.feet, every_substep)


@pytest.mark.parametrize("feature", REFUSED)
def test_the_contract_refuses(feature, tmp_path):
    change, words = REFUSED[feature]
    with pytest.raises(config_lib.ConfigError) as caught:
        load(change, tmp_path)
    text = str(caught.value)
    assert text.startswith(f"{tmp_path / 'mine.xml'}: ") and "\n" not in text and words in text


@pytest.mark.parametrize("feature", COMPLETED)
def test_what_is_completed_is_computed(feature, tmp_path):
    change, words = COMPLETED[feature]
    robot = load(change, tmp_path)
    case = Case("go1", robot=robot)
    assert words in "; ".join(robot.notes) and kernel(case) == "quadruped"


@pytest.mark.parametrize("feature", DECLINED)
def test_the_kernel_declines(feature, tmp_path):
    change, words = DECLINED[feature]
    case = Case("go1", robot=load(change, tmp_path))
    assert words in declines(case) and kernel(case) == ""


@pytest.mark.parametrize("feature", IN_TREES)
def test_the_kernel_of_trees_takes_what_that_of_quadrupeds_does_not(feature, tmp_path):
    change, words = IN_TREES[feature]
    case = Case("go1", robot=load(change, tmp_path))
    assert kernel(case) == "tree" and not declines(case)
    assert words in scope.no_quadruped(case.model, case.robot.feet, False)


# other sizes are other kernels, which take seconds to build; test_tree_kernel.py has such feet
BUILT = [
    pytest.param(name, marks=[pytest.mark.slow] * ("a foot" in name))
    for name in (*IN_TREES, "nothing")
]


@pytest.mark.parametrize("feature", BUILT)
def test_the_kernel_of_trees_computes(feature, tmp_path):
    change = (IN_TREES[feature] if feature in IN_TREES else [COMPUTED[feature]])[0]
    compare(Case("go1", robot=load(change, tmp_path), way=tree))


def test_parts_of_each_physics_step_are_for_the_kernel_of_trees():
    case = Case("go1")
    assert kernel(case) == "quadruped" and kernel(case, True) == "tree"


def chain(joints, feet, kind="sphere"):
    """`(model, feet)` of a base with a chain of hinges, its feet at the end."""
    sizes = dict(sphere=".1", box=".1 .1 .1", capsule=".1 .1", cylinder=".1 .1")
    shape = f'<geom type="{kind}" size="{sizes[kind]}" priority="1"/>'
    part = '<geom size=".01" contype="0" conaffinity="0"/>'
    link = f'<body pos="0 0 -.1"><joint axis="0 1 0" range="-1 1"/>{part}'
    text = f"""<mujoco><compiler angle="radian" autolimits="true"/><worldbody>
      <geom name="floor" type="plane" size="0 0 1" conaffinity="0"/>
      <body><freejoint/>{part}
      {link * joints}{shape * feet}{"</body>" * joints}</body></worldbody></mujoco>"""
    spec = mujoco.MjSpec.from_string(text)
    for i, joint in enumerate(spec.joints[1:]):
        joint.name = f"joint{i}"
        spec.add_actuator(
            name=joint.name, target=joint.name, trntype=mujoco.mjtTrn.mjTRN_JOINT
        ).set_to_motor()
    for geom in spec.geoms[1:]:
        geom.contype = 0
    model = spec.compile()
    return model, np.flatnonzero(model.geom_priority)


def test_a_tree_has_as_many_joints_as_a_warp_has_threads():
    """And so many points of contact as fit into a processor's memory."""
    assert scope.declines(*chain(32, 64)) == ""
    assert scope.declines(*chain(32, 16, "box")) == ""
    assert scope.declines(*chain(33, 1)) == "more than 32 joints"
    assert "64 points" in scope.declines(*chain(2, 65))
    assert "64 points" in scope.declines(*chain(2, 33, "capsule"))
    assert "no spheres, capsules or boxes" in scope.declines(*chain(2, 1, "cylinder"))
    assert scope.declines(*chain(0, 1)) == "feet that no joint moves"


@pytest.mark.parametrize("feature", COMPUTED)
def test_the_kernel_computes(feature, tmp_path):
    case = Case("go1", robot=load(COMPUTED[feature], tmp_path))
    assert kernel(case) == "quadruped"
    compare(case)


def compare(case, steps=STEPS):
    """Physics steps from every state, C MuJoCo's solver run to the end, under the kernel's torques."""
    twins, found = {i: case.of_robot(i) for i in range(0, ROBOTS, 4)}, case.before
    for step in range(steps):
        found = case.step(found)
        for i, (model, data) in twins.items():
            drive(data, found["torque"][i])
            mujoco.mj_step(model, data)
            if step == 0:
                qacc = data.qacc_warmstart
                close(found["qacc_warmstart"][i], qacc, atol=3e-5 * abs(qacc).max())
            close(found["qvel"][i], data.qvel, atol=1e-4)
            close(found["qpos"][i], data.qpos, atol=1e-6)


def floats():
    """Every field of floating numbers of a compiled model and of its options, and of geoms that touch
    nothing."""
    model = robot_lib.load("go1").mj_model
    for of, where in ((model, ""), (model.opt, "opt.")):
        for name in dir(of):
            value = getattr(of, name)
            if name == "geom_pos":  # C MuJoCo keeps boxes around them; "another foot" moves one
                continue
            if isinstance(value, float) or (isinstance(value, np.ndarray) and value.dtype == float):
                if np.size(value):
                    yield where + name
                    if name.startswith("geom_"):
                        yield f"{name} of parts"


@pytest.mark.parametrize("field", floats())
def test_whatever_number_is_another_is_declined_or_does_as_in_c_mujoco(field):
    """Also what is called harmless: it changes nothing in C MuJoCo."""
    case = Case("go1")
    case.model = model = copy.copy(case.model)
    name, _, parts = field.partition(" of ")
    of = model.opt if name.startswith("opt.") else model
    value = np.array(getattr(of, name.removeprefix("opt.")), float)
    rows = case.robot.parts if parts else ...
    value[rows] = np.where(value[rows], 1.1 * value[rows], 0.1)
    setattr(of, name.removeprefix("opt."), value if value.ndim else float(value))
    if not declines(case):
        case.way = quadruped if kernel(case) == "quadruped" else tree
        compare(case, 1)


INTEGRATORS = "RK4", "IMPLICIT", "DISCRETE"
LACKS = {  # what an engine has not, of what the contract allows
    "jax": {
        "a nonlinear spring": "jnt_stiffnesspoly",
        "nonlinear damping": "dof_dampingpoly",
        "a sticky foot": "geom_adhesion",
        "a conveyor belt": "geom_surfacevel",
        "noslip": "noslip_iterations",
        "integrator IMPLICIT": "mjINT_IMPLICIT",
        "integrator DISCRETE": "discrete",
        "flag ENBL_ENERGY": "mjENBL_ENERGY",
    },
    "warp": {
        "flag DSBL_AUTORESET": "mjDSBL_AUTORESET",
        "flag ENBL_OVERRIDE": "mjENBL_OVERRIDE",
    },
    "c": {f"integrator {name}": f"has the integrator {name.lower()}" for name in INTEGRATORS},
}


@pytest.mark.parametrize(
    ("impl", "feature"), [(impl, feature) for impl, lacks in LACKS.items() for feature in lacks]
)
def test_an_engine_refuses_what_it_lacks(impl, feature, tmp_path):
    """In one line, before anything is compiled; an engine that has it does not."""
    robot = load(DECLINED[feature][0], tmp_path)
    physics = config_lib.validate(config_lib.load("configs/go1.py")).physics
    with pytest.raises(config_lib.ConfigError) as caught:
        engine_lib.make(robot, physics, frozenset(), impl)
    text = str(caught.value)
    assert str(robot.xml) in text and "\n" not in text and LACKS[impl][feature] in text
    other = next(other for other in reversed(LACKS) if feature not in LACKS[other])
    engine_contract.check(robot, physics, other)


@pytest.mark.parametrize("feature", DECLINED)
def test_there_is_room_for_every_contact_and_constraint_in_mujoco_warp(feature, tmp_path):
    """All feet and parts in the floor, all joints beyond their range."""
    case = Case("go1", robot=load(DECLINED[feature][0], tmp_path))
    case.model.geom_conaffinity[case.robot.parts] = 1
    contacts, rows = contacts_lib.most(case.model)
    data = mujoco.MjData(case.model)
    data.qpos[:7] = [0, 0, -0.5, 1, 0, 0, 0]
    for side in (0, 1):
        data.qpos[7:] = case.model.jnt_range[1:, side] + (0.05, -0.05)[1 - side]
        mujoco.mj_forward(case.model, data)
        assert data.ncon <= contacts and data.nefc <= rows


ELSEWHERE = (  # of each kind one
    "joint equality",
    "tendon equality",
    "a tendon's spring",
    "a tendon's dry friction",
    "a tendon's limit",
    "a tendon's armature",
    "a spatial tendon",
    "a pair of parts",
    "an exclude of the floor",
    "a spring",
    "damping of the base",
    "a joint's margin",
    "a foot's gap",
    "compensation by motors",
    "wind",
    "gravity aslant",
)
# not in one file with the others: one tendon has this name, and in MJX an exclude also ends a pair
APART = (
    "tendon equality",
    "a tendon's dry friction",
    "a tendon's limit",
    "a tendon's armature",
    "a pair of parts",
)
IN_WARP_ALONE = "a nonlinear spring", "cubic damping", "a sticky foot", "a conveyor belt"


@pytest.mark.slow
@pytest.mark.parametrize("feature", (*ELSEWHERE, *IN_WARP_ALONE))
def test_mujoco_warp_computes_what_the_kernel_declines(feature, tmp_path):
    case = Case("go1", robot=load(DECLINED[feature][0], tmp_path))
    found = case.step(case.before, general)
    for i in range(0, ROBOTS, 4):
        model, data = case.of_robot(i)
        drive(data, found["torque"][i])
        mujoco.mj_step(model, data)
        close(found["qvel"][i], data.qvel, atol=1e-3)


@pytest.mark.slow
def test_mjx_computes_what_the_kernel_declines(tmp_path):
    """All at once, because a program takes long to compile."""
    case = Case(
        "go1",
        robot=load(both(*(DECLINED[name][0] for name in ELSEWHERE if name not in APART)), tmp_path),
    )
    model = mjx.put_model(case.model, impl="jax")
    torque = np.random.default_rng(0).normal(0, 5, (ROBOTS, 12))

    def step(qpos, qvel, ctrl):
        data = mjx.make_data(case.model, impl="jax").replace(qpos=qpos, qvel=qvel, ctrl=ctrl)
        return mjx.step(model, data).qvel

    given = [np.float32(x) for x in (case.before["qpos"], case.before["qvel"], torque)]
    with jax.default_matmul_precision("highest"):
        found = jax.jit(jax.vmap(step))(*given)
    for i in range(ROBOTS):
        data = mujoco.MjData(case.model)
        data.qpos[:], data.qvel[:], data.ctrl[:] = (x[i] for x in given)
        mujoco.mj_step(case.model, data)
        close(found[i], data.qvel, atol=1e-3)


@pytest.mark.parametrize(
    ("feet", "impl", "says"),
    [
        (other_robots.MIXED, "jax", "MJX cannot simulate it (cylinders on a height map)"),
        (other_robots.BOX, "warp", "because of feet that are boxes, on ground that is not flat"),
        (other_robots.CAPSULES, "warp", ""),
        (other_robots.CAPSULES, "jax", ""),
    ],
)
def test_what_an_engine_lacks_on_rough_ground_is_said_before_it_is_made(
    feet, impl, says, monkeypatch
):
    """What `train` refuses in a second, and notes after it has compiled; on flat ground neither."""
    robot, told = other_robots.biped(feet), []
    monkeypatch.setattr(robot_lib, "load", lambda name: robot)
    monkeypatch.setattr(devices, "engine", lambda config: impl)
    monkeypatch.setattr(build, "_begin_warp", lambda: None)
    for terrain in ("flat", "rough"):
        config = config_lib.load("configs/default.py")
        config.task.update(terrain=terrain, carry_on=False)
        config.physics.impl, config.ppo.symmetry = impl, False
        config = config_lib.validate(config)
        program = SimpleNamespace(robot=robot, impl=impl)
        try:
            build.check(config)
            told.append(build.engine_note(program, config))
        except config_lib.ConfigError as error:
            told.append(str(error))
    assert told[0] == "" and (says in told[1] if says else told[1] == "")
