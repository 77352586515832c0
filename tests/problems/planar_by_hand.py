"""Scenes of rigid bodies in the plane in equations written by hand, against which their mechanisms are judged."""

import jax.numpy as jnp
import numpy as np

from hhtbench.mechanics import bushings, contact, forces, plane
from hhtbench.protocol.system import System, parameter


class Bodies(System):
    """k free bodies (x, y, angle)."""

    m: object = parameter(doc="masses (k,) [kg]")
    J: object = parameter(doc="moments of inertia (k,) [kg m^2]")
    g: object = parameter(doc="[m/s^2]")

    @property
    def mass_matrix(self):
        return plane.mass_of_bodies(self.m, self.J)

    def force(self, t, q, v):
        return plane.weight_of_bodies(self.m, jnp.stack([0.0, -self.g]))


class Chain(Bodies):
    """Bars of problems/bushing_chain.py."""

    length: object = parameter(doc="[m]")
    stiffness: object = parameter(doc="(3,) [N/m, N/m, N m/rad]")
    damping: object = parameter(doc="(3,) [N s/m, N s/m, N m s/rad]")

    def offsets(self, q):
        bars = np.arange(self.m.size)
        end = jnp.stack([self.length / 2, 0.0])
        ends = jnp.where((bars == 0)[:, None], 0.0, end)  # the ground's is the origin
        return bushings.offsets_in_plane(plane.placed_with_ground(q), bars - 1, bars, ends, -end[None])

    def force(self, t, q, v):
        law = forces.spring_damper(self.stiffness, self.damping, 0.0)
        return super().force(t, q, v) + forces.force_of(self.offsets, law, q, v)


def chain(n_bars=20, m=1.8, J=0.001, length=0.0753, k=7e7, c=3.5e3, turning_k=500.0, turning_c=25.0, g=9.81):
    stiffness, damping = [k, k, turning_k], [c, c, turning_c]
    return Chain(m=np.full(n_bars, m), J=np.full(n_bars, J), g=g, length=length, stiffness=stiffness, damping=damping)


class Windows(Bodies):
    """Cranks and couplers of problems/four_bars.py."""

    l: object = parameter(doc="[m]")  # noqa: E741

    def constraint(self, t, q):
        bars, cranks = q.reshape(-1, 3), self.m.size // 2 + 1
        arm = self.l / 2 * jnp.stack([jnp.cos(bars[:, 2]), jnp.sin(bars[:, 2])], axis=1)
        begins, ends = bars[:, :2] - arm, bars[:, :2] + arm
        ground = self.l * jnp.stack([jnp.arange(cranks), jnp.zeros(cranks)], axis=1)
        joints = [begins[:cranks] - ground, begins[cranks:] - ends[: cranks - 1], ends[cranks:] - ends[1:cranks]]
        return jnp.concatenate(joints).ravel()


def windows(n_windows=2, m=1.0, l=1.0, g=9.81, speed=1.0):  # noqa: E741
    masses = np.full(2 * n_windows + 1, m)
    return Windows(m=masses, J=masses * l**2 / 12, g=g, l=l)


class Cam(Bodies):
    """Cam and follower of problems/cam_follower.py."""

    ecc: object = parameter(doc="[m]")
    clear: object = parameter(doc="of a flat from the middle of the follower [m]")
    Om: object = parameter(doc="[rad/s]")
    spring_k: object = parameter(doc="[N/m]")
    law: object = parameter(doc="k, c and onset of contact (3,)")
    rub: object = parameter(doc="coefficient of friction and creep (2,)")

    def constraint(self, t, q):
        at, none = plane.placed_with_ground(q), jnp.zeros((1, 2))
        pin = plane.revolute_rows(at, [0], [-1], jnp.stack([-self.ecc, 0.0])[None], none)
        guide = plane.prismatic_rows(at, [1], [-1], none, none, np.array([[0.0, 1.0]]))
        return jnp.concatenate([pin, guide, q[2:3] - self.Om * t])

    def contacts(self, q):
        at, side = plane.placed_with_ground(q), np.array([[0.0, 1.0], [0.0, -1.0]])
        flats = plane.points_on(at, [1, 1], side * self.clear)
        return contact.on_plane(at.x[np.array([0, 0])], 0.05, flats, plane.turned(at.angle[1], -side))

    def force(self, t, q, v):
        gaps, law = lambda q: self.contacts(q).gap, contact.hunt_crossley(*self.law)
        rubs = contact.friction_force(plane, [0], [1], self.contacts(q), -law(*forces.rates(gaps, q, v)), self.rub, q, v)
        spring = jnp.zeros(6).at[4].set(-self.spring_k * q[4])
        return super().force(t, q, v) + spring + forces.force_of(gaps, law, q, v) + rubs


def cam(ecc=0.02, backlash=5e-4, Om=40.0, spring_k=500.0, k=1e8, c=0.5, mu=0.1, onset=1e-5, creep=0.02):
    given = {"ecc": ecc, "clear": 0.05 + backlash / 2, "Om": Om, "spring_k": spring_k}
    m = np.array([3.0, 2.0])
    return Cam(m=m, J=m * 0.05**2 / 2, g=9.81, law=[k, c, onset], rub=[mu, creep], **given)


class Band(Bodies):
    """Shoes and wheels of problems/band_track.py."""

    radius: object = parameter(doc="of the wheels [m]")
    bearing: object = parameter(doc="of the second wheel (2,) [m]")
    stiffness: object = parameter(doc="(3,) [N/m, N/m, N m/rad]")
    damping: object = parameter(doc="(3,) [N s/m, N s/m, N m s/rad]")
    law: object = parameter(doc="k, c and onset of contact (3,)")
    rub: object = parameter(doc="coefficient of friction and creep (2,)")
    torque: object = parameter(doc="of the motor at rest [N m], and of motor and brake per rate [N m s], (3,)")

    def constraint(self, t, q):
        return jnp.concatenate([q[-6:-4], q[-3:-1] - self.bearing])

    def offsets(self, q):  # the angle grows by a turn once around, which the last makes good
        shoes = np.arange(self.m.size - 2)
        end = jnp.array([[0.1101 / 2, 0.0]])
        found = bushings.offsets_in_plane(plane.placed_with_ground(q), shoes, np.roll(shoes, -1), end, -end)
        return found.at[-1, 2].add(2 * np.pi)

    def force(self, t, q, v):
        n = self.m.size - 2
        shoes, wheels = np.tile(np.arange(n), 2), np.repeat([n, n + 1], n)
        at, law = lambda q: plane.placed_with_ground(q).x, contact.hunt_crossley(*self.law)
        contacts = lambda q: contact.on_sphere(at(q)[shoes], 0.01, at(q)[wheels], self.radius)  # noqa: E731
        gaps = lambda q: contacts(q).gap  # noqa: E731
        rubs = contact.friction_force(plane, shoes, wheels, contacts(q), -law(*forces.rates(gaps, q, v)), self.rub, q, v)
        push = forces.force_of(gaps, law, q, v)
        held = forces.force_of(self.offsets, forces.spring_damper(self.stiffness, self.damping, 0.0), q, v)
        torques = jnp.stack([self.torque[0] - self.torque[1] * v[-4], -self.torque[2] * v[-1]])
        return (super().force(t, q, v) + push + rubs + held).at[np.array([-4, -1])].add(torques)


def band(n_wrap=6, n_free=4, k=7e7, c=3.5e6, turning_k=500.0, turning_c=25.0, contact_k=6e6, **given):
    law = {"loss": 0.2, "onset": 2e-4, "mu": 0.8, "creep": 0.05, "motor": 20.0, "Om": 10.0, "brake": 5.0} | given
    shoes, radius = 2 * (n_wrap + n_free), 0.1101 / (2 * np.tan(np.pi / (2 * n_wrap))) - 0.01
    return Band(
        m=np.append(np.full(shoes, 2.13), [40.0, 40.0]),
        J=np.append(np.full(shoes, 0.002), [20.0 * radius**2, 20.0 * radius**2]),
        g=9.81,
        radius=radius,
        bearing=[n_free * 0.1101, 0.0],
        stiffness=[k, k, turning_k],
        damping=[c, c, turning_c],
        law=[contact_k, law["loss"], law["onset"]],
        rub=[law["mu"], law["creep"]],
        torque=[law["motor"] * law["Om"], law["motor"], law["brake"]],
    )


SCENES = {"bushing_chain": chain, "four_bars": windows, "cam_follower": cam, "band_track": band}
