"""``hhtbench verify damping``: amplification, damping, period and overshoot against closed forms.

Each scene has one free direction ``u`` (n,) with u^T M u = 1.  The force along it is ``-w^2 y - 2 zeta w y'`` with
``y = u^T M q``; a force across it is balanced by reactions.  For the extended method (y, h y', h^2 u^T M a) is then
advanced by the matrix (H18), with or without constraints: reactions do not enter the tangential motion.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from hhtbench.protocol.arguments import Matrix, Vector
from hhtbench.protocol.evidence import Curve, Evidence, Plot, Row
from hhtbench.protocol.system import System, parameter
from solvers.hht.solver import HHT
from solvers.hht.verify.measure import solved, step_by_hand
from solvers.hht.verify.study import ALPHAS, NAMES, Method, Progress, Study, below_row, judged_row, verify

STEP = 0.01  # h [s]; the matrix depends on w h alone
MASS = np.array([[2.0, 0.3, 0.1], [0.3, 1.0, -0.2], [0.1, -0.2, 1.5]])
ROWS = np.array([[1.0, 2.0, -1.0], [0.5, -1.0, 1.0]])
ACROSS = (0.7, -0.4)  # force across the free direction per force along it, for each row of ROWS
AMPLITUDE = 1e-3  # [rad] of the bead: its square is far below the measured elongations
DIED_OUT = 20  # steps: the third root is below 1e-3 at w h <= 0.1
ROUNDOFF = 1e-12  # bound on errors of trace, minors and determinant
AGREES = 1e-3  # relative error of the recurrence fitted to a run
LEADING = 0.02  # relative error of the first term of the series at w h = 0.1
UNDAMPED = 1e-8  # damping ratio that counts as none
DRAWN = (0.0, -0.05, -0.15, -1.0 / 3.0)  # alpha of the curves; that of -0.3 would lie on -1/3
MEASURED = tuple(np.logspace(-2, 8, 31).tolist())  # w h of measured points; few enough to be drawn as marks
CLOSED = tuple(np.logspace(-2, 8, 601).tolist())  # w h of closed forms; so many are drawn as a line
SMOOTH = 1.0 + 1e-9  # w h up to which a vibration is resolved: six steps a period
GUIDED_UP_TO = 1e4  # w h of the guided scene: Newton's iteration fails far above it, as springs across are as stiff
RADIUS = (
    "The factor by which one step multiplies a vibration at most: 1 at alpha = 0 for every frequency, "
    "(1 + alpha)/(1 - alpha) at infinity. "
    "The guided scene, with springs across its constraints, has the radius of the oscillator."
)
DAMPING = "Numerical damping grows as the cube of the frequency: slow motion is spared. alpha = 0 has none and is not drawn."
ELONGATION = "Periods come out too long by a part that grows as the square of the frequency, least at alpha = 0."

Spectrum = NDArray[np.complex128]
Found = list[tuple[str, float, dict[float, Spectrum]]]  # (label, alpha, eigenvalues by w h) of each curve


def verify_damping(progress: Progress | None = None, jobs: int = 1) -> Evidence:
    """Evidence on how ``alpha`` or ``rho_inf`` damps vibrations, measured by stepping; a minute on one core."""
    return verify("Damping in the user's terms", STUDIES, progress, jobs)


class Masses(System):
    """Masses on springs and dampers, with the constraints of a scene."""

    mass_matrix: Any = parameter(doc="[kg]")
    stiffness: Any = parameter(doc="[N/m]")
    damper: Any = parameter(doc="[N s/m]")
    constraint: Any = eqx.field(static=True, default=None)
    velocity_constraint: Any = eqx.field(static=True, default=None)

    def force(self, t: Any, q: Any, v: Any) -> Any:
        """Spring and damper forces (n,)."""
        return -(self.stiffness @ q) - self.damper @ v


CONSTRAINTS: dict[str, dict[str, Callable[..., Any]]] = {
    "oscillator": {},
    "guided": {"constraint": lambda t, q: ROWS @ q},
    "rolling": {"velocity_constraint": lambda t, q, v: ROWS @ v},
    "mixed": {"constraint": lambda t, q: ROWS[:1] @ q, "velocity_constraint": lambda t, q, v: ROWS[1:] @ v},
    "bead": {"constraint": lambda t, q: jnp.stack([(q @ q - 1.0) / 2.0])},
}


@dataclass(frozen=True)
class Scene:
    """A system whose frequency and damping are still free, with its free direction."""

    name: str
    mass: Matrix  #: (n, n)
    free: Vector  #: (n,) u
    shape: Matrix  #: (n, n) stiffness for w = 1; the damper is proportional to it
    start: Vector  #: (n,) q at which it starts from rest
    constraints: Mapping[str, Callable[..., Any]] = field(default_factory=dict)

    @property
    def along(self) -> Vector:
        """M u (n,): y = along @ q."""
        return self.mass @ self.free

    def integrator(self, method: Method, frequency: float, zeta: float = 0.0, kind: type[HHT] = HHT) -> HHT:
        """Integrator of class ``kind`` for w h = ``frequency``, damping ratio ``zeta`` and steps of STEP."""
        omega = frequency / STEP
        stiffness, damper = omega**2 * self.shape, 2.0 * zeta * omega * self.shape
        return kind(Masses(mass_matrix=self.mass, stiffness=stiffness, damper=damper, **self.constraints), **method)


def make_scene(name: str) -> Scene:
    """Build one of the scenes of CONSTRAINTS.

    The bead on a circle of 1 m is pulled to the vertical line through its centre.  The others with constraints have three
    coordinates and two rows.  Springs couple both ways with a coordinate held by a position constraint.  A velocity
    constraint lets it drift by O(h^3) a step, so there the coupling goes one way, from y into the reaction.  The springs
    across are as stiff as those along: soft ones would be lost in the roundoff of a stiffness of 1e16 in skew coordinates.
    """
    if name == "oscillator":
        one = np.ones((1, 1))
        return Scene(name, one, one[0], one, one[0])
    if name == "bead":
        start, free = np.array([np.sin(AMPLITUDE), -np.cos(AMPLITUDE)]), np.array([1.0, 0.0])
        return Scene(name, np.eye(2), free, np.diag(free), start, CONSTRAINTS[name])
    free = np.cross(*ROWS)
    free = free / np.sqrt(free @ MASS @ free)
    along = MASS @ free
    shape = np.outer(along, along) + ROWS.T @ ROWS + np.outer(ACROSS @ ROWS, along)
    if name != "rolling":
        shape = shape + ACROSS[0] * np.outer(along, ROWS[0])
    return Scene(name, MASS, free, shape, free, CONSTRAINTS[name])


def measured_matrix(scene: Scene, method: Method, frequency: float, zeta: float = 0.0, kind: type[HHT] = HHT) -> Matrix:
    """The (3, 3) map of (y, h y', h^2 u^T M a) in one step with w h = ``frequency``, measured column by column."""
    hht, u, along, columns = scene.integrator(method, frequency, zeta, kind), scene.free, scene.along, []
    for q, v, a in np.eye(3):
        hht.init_step(0.0, q * u, v * u / STEP, step=STEP)
        hht.restart(replace(hht.state, a=a * u / STEP**2, h=STEP))
        state = step_by_hand(scene.name, hht)
        columns.append([along @ state.q, STEP * (along @ state.v), STEP**2 * (along @ state.a)])
    return np.array(columns).T


class Swing(NamedTuple):
    """Damping ratio and period elongation of a vibration."""

    damping: float  #: damping ratio xi
    elongation: float  #: relative elongation of the period 2 pi / w


def swing_of(eigenvalues: Spectrum, frequency: float) -> Swing:
    """Damping and elongation from the eigenvalues of one step at w h = ``frequency``."""
    principal = np.log(max(eigenvalues, key=lambda root: root.imag))
    return Swing(float(-principal.real / abs(principal)), float(frequency / principal.imag - 1.0))


def measured_swing(scene: Scene, method: Method, frequency: float, periods: float) -> Swing:
    """Damping and elongation from y2 = p y1 - d y0 fitted to an undamped run once its third root has decayed."""
    steps = int(np.ceil(periods * 2.0 * np.pi / frequency))
    start = (0.0, steps * STEP), scene.start, np.zeros(scene.start.size)
    y = solved(scene.name, scene.integrator(method, frequency), *start, steps=steps).q[DIED_OUT:] @ scene.along
    (p, d), *_ = np.linalg.lstsq(np.stack([y[1:-1], -y[:-2]], axis=1), y[2:], rcond=None)
    return swing_of(np.roots([1.0, -p, d]).astype(np.complex128), frequency)


def closed_invariants(alpha: float, frequency: float, zeta: float) -> tuple[float, float, float]:
    """Trace, sum of principal minors and determinant of the matrix (H18) with (H3), in closed form."""
    a, o, e = alpha, frequency, 1.0 + alpha
    d = 4.0 + (1.0 - a) ** 2 * e * o**2 + 4.0 * zeta * o * e * (1.0 - 2.0 * a)
    trace = (8.0 + (3.0 * a**3 - a - 2.0) * o**2 - 12.0 * zeta * o * a * (1.0 + 2.0 * a)) / d
    minors = (4.0 + (3.0 * a**3 + 3.0 * a**2 + a + 1.0) * o**2 - 4.0 * zeta * o * (6.0 * a**2 + 3.0 * a + 1.0)) / d
    return trace, minors, a * o * (e**2 * o - 4.0 * zeta * (1.0 + 2.0 * a)) / d


def roots(alpha: float, frequency: float, zeta: float = 0.0) -> Spectrum:
    """The three complex eigenvalues of (H18), as roots of its characteristic polynomial."""
    trace, minors, determinant = closed_invariants(alpha, frequency, zeta)
    return np.roots([1.0, -trace, minors, -determinant]).astype(np.complex128)


def series(alpha: float, frequency: float) -> Swing:
    """Leading terms in w h of damping and elongation for zeta = 0, from the principal root of (H18)."""
    damping = -alpha * (1.0 + alpha) ** 2 * frequency**3 / 8.0
    return Swing(damping, frequency**2 * (2.0 - 6.0 * alpha - 9.0 * alpha**2) / 24.0)


def spectrum(matrix: Matrix) -> Spectrum:
    """Eigenvalues of ``matrix``, as complex numbers."""
    return np.linalg.eigvals(matrix).astype(np.complex128)


def radius(eigenvalues: Spectrum) -> float:
    """Spectral radius: largest magnitude of the eigenvalues."""
    return float(np.max(np.abs(eigenvalues)))


def one_step(name: str, alphas: Sequence[float], method: Method, cases: Sequence[tuple[float, float]]) -> Row:
    """Row: invariants of one step of a scene against closed forms, worst over ``alphas`` and ``cases`` (w h, zeta).

    Errors are relative to the larger of one and the value.
    """
    scene, worst = make_scene(name), 0.0
    for alpha, (frequency, zeta) in itertools.product(alphas, cases):
        _, trace, minors, determinant = np.poly(measured_matrix(scene, {**method, "alpha": alpha}, frequency, zeta))
        closed = np.array(closed_invariants(alpha, frequency, zeta))
        errors = np.abs([-trace, minors, -determinant] - closed) / np.maximum(1.0, np.abs(closed))
        worst = max(worst, float(errors.max()))
    label = name if scene.free.size == 1 else f"{name}, {_variant(method)}"
    highest = max(frequency for frequency, _ in cases)
    seen = f"{label}, alpha = {', '.join(NAMES[a] for a in alphas)}, w h = 0.01 ... {highest:g}, zeta = 0 and 0.05"
    claim = f"{seen}: trace, minors, determinant of one step, whose eigenvalues are its amplification"
    return below_row(f"matrix/{name}", claim, worst, ROUNDOFF)


def _variant(method: Method) -> str:
    """Label of the method without its damping."""
    return f"{method['reaction']}, b = {method['b']:g}"


def rho_inf(rho: float) -> Row:
    """Row: ``HHT(system, rho_inf=rho)`` has that spectral radius at the highest frequency, (H18)."""
    measured = radius(spectrum(measured_matrix(make_scene("oscillator"), {"rho_inf": rho}, 1e8)))
    bound = 1e-5 if rho == 0.5 else 1e-6  # at 1/2 the radius comes down as (w h)^(-2/3) only
    claim = f"HHT(rho_inf={rho:g}), w h = 1e8: spectral radius of one step less rho_inf"
    return below_row("rho_inf", claim, abs(measured - rho), bound)


def swing(name: str, method: Method, frequency: float, periods: float) -> list[Row]:
    """Rows: damping ratio and period elongation of a run against eigenvalues and the leading terms of their series."""
    alpha, rows = method["alpha"], []
    found = measured_swing(make_scene(name), method, frequency, periods)
    exact, leading = swing_of(roots(alpha, frequency), frequency), series(alpha, frequency)
    run = f"{name}, {_variant(method)}, alpha = {NAMES[alpha]}, w h = {frequency:g}, {periods:g} periods"
    for quantity, measured, root, first in zip(Swing._fields, found, exact, leading, strict=True):
        id, claim = f"{quantity}/{name}", f"{run}: {quantity} (eigenvalue {root:.5g}, series {first:.5g})"
        if first == 0.0:
            rows.append(below_row(id, claim, abs(measured), UNDAMPED))
            continue
        close = abs(measured - root) < AGREES * abs(root) and abs(measured - first) < LEADING * abs(first)
        bound = f"{AGREES:.1%} of the eigenvalue, {LEADING:.0%} of the series"
        rows.append(judged_row(id, claim, f"{measured:.5g}", bound, close))
    return rows


def overshoot(alpha: float) -> Row:
    """Row: the first step from y0 with a0 = f0, and from y'0, against the limit of (H18) for w h -> infinity."""
    frequency = 1e4  # the limit is reached to O((w h)^-2), roundoff of a0 grows as (w h)^2: they meet here
    matrix = measured_matrix(make_scene("oscillator"), {"alpha": alpha}, frequency)
    y, z, _ = matrix @ np.array([1.0, 0.0, -(frequency**2)])
    found = np.array([y, z / frequency**2, matrix[1, 1]])
    scale = (1.0 - alpha) ** 2
    position = (alpha**3 - alpha**2 - alpha - 1.0) / (scale * (1.0 + alpha))  # in [-1, 1]
    limits = np.array([position, -(alpha**2) / scale, (alpha**2 + 2.0 * alpha - 1.0) / scale])
    text = f"y1/y0 = {y:.4f}, y'1/(w y0) = {z / frequency**2:.4f} w h, y'1/y'0 = {matrix[1, 1]:.4f}"
    claim = f"alpha = {NAMES[alpha]}, w h = 1e4: {text}: error against their limits; no overshoot in y"
    return below_row("overshoot", claim, float(np.max(np.abs(found - limits))), 1e-6)


def curves() -> list[Plot]:
    """The three plots for zeta = 0; closed forms last, so that they are drawn over the lines between the marks."""
    up_to = [x for x in MEASURED if x <= GUIDED_UP_TO]
    found: Found = [("guided", -0.15, _measured("guided", {"alpha": -0.15, "b": 0.25}, up_to))]
    found += [("measured", alpha, _measured("oscillator", {"alpha": alpha}, MEASURED)) for alpha in DRAWN]
    found += [("closed form", alpha, {x: roots(alpha, x) for x in CLOSED}) for alpha in DRAWN]
    slow = [(name, alpha, {x: r for x, r in at.items() if x <= SMOOTH}) for name, alpha, at in found if name != "guided"]
    damped = [one for one in slow if one[1] != 0.0]
    return [
        _plot("radius", "Spectral radius", RADIUS, found, lambda r, x: radius(r)),
        _plot("damping", "Damping ratio", DAMPING, damped, lambda r, x: swing_of(r, x).damping),
        _plot("elongation", "Period elongation", ELONGATION, slow, lambda r, x: swing_of(r, x).elongation),
    ]


def _measured(name: str, method: Method, frequencies: Iterable[float]) -> dict[float, Spectrum]:
    scene = make_scene(name)
    return {x: spectrum(measured_matrix(scene, method, x)) for x in frequencies}


def _plot(id: str, title: str, caption: str, found: Found, of: Callable[[Spectrum, float], float]) -> Plot:
    lines = []
    for name, alpha, at in found:
        values = tuple(max(of(eigenvalues, x), 0.0) or math.nan for x, eigenvalues in at.items())
        lines.append(Curve(label=f"alpha = {NAMES[alpha]}, {name}", x=tuple(at), y=values))
    x_label = "\N{GREEK SMALL LETTER OMEGA} h"
    return Plot(id=id, title=title, caption=caption, x_label=x_label, y_label=title.lower(), curves=tuple(lines))


REACTIONS = ("implicit", 0.0), ("implicit", 0.25), ("predictor", 0.0), ("predictor", 0.25), ("midpoint", 0.0)
METHODS = tuple({"b": b, "reaction": reaction} for reaction, b in (*REACTIONS, ("midpoint_predictor", 0.0)))
IMPLICIT, HALF, MIDPOINT = METHODS[0], METHODS[1], METHODS[4]
UP_TO_1E4 = ((1e-2, 0.0), (1.0, 0.05), (1e2, 0.0), (1e4, 0.05))  # w h and zeta of the constrained scenes
UP_TO_1E8 = tuple((10.0**k, zeta) for k in range(-2, 9) for zeta in (0.0, 0.05))
OSCILLATOR: tuple[Study, ...] = tuple((one_step, "oscillator", (alpha,), IMPLICIT, UP_TO_1E8) for alpha in ALPHAS)
STUDIES: tuple[Study, ...] = (
    *OSCILLATOR,
    *((rho_inf, rho) for rho in (1.0, 0.9, 0.7, 0.55, 0.5)),
    *((swing, "oscillator", {**IMPLICIT, "alpha": alpha}, x, 2000.0 * x) for alpha in ALPHAS for x in (0.05, 0.1)),
    *((overshoot, alpha) for alpha in ALPHAS),
    *((one_step, "guided", ALPHAS, method, UP_TO_1E4) for method in METHODS),
    *((one_step, "mixed", ALPHAS, method, UP_TO_1E4) for method in (IMPLICIT, HALF, METHODS[3], MIDPOINT)),
    (one_step, "rolling", ALPHAS, IMPLICIT, UP_TO_1E4),
    *((swing, "bead", {**method, "alpha": alpha}, 0.1, 20) for method in (HALF, MIDPOINT) for alpha in (0.0, -0.3)),
    (curves,),
)
