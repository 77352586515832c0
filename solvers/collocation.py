"""``collocation(form=ggl|index2|index1, stages=7)``: Radau IIA of high order, for reference solutions.

Order 2 s - 1 with s stages, 13 for seven, so that roundoff is reached with few steps, also on stiff problems and with both
constraint levels as equations.  Our own implementation, slow per step: it certifies other solvers and does not compete.

A step seeks a polynomial of degree s through the start that satisfies F(t, y, y') = 0 at s nodes, the last at the end of the
step: E. Hairer, G. Wanner, Solving Ordinary Differential Equations II, Springer 1996, section VII.4.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from functools import cache, partial
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from scipy import linalg, special

from hhtbench.protocol.arguments import Matrix, Vector, positive_integer
from hhtbench.protocol.errors import ProblemError
from hhtbench.protocol.printing import exact
from hhtbench.solution.result import Status
from solvers._adapter import Adapter, choose
from solvers._dense import Polynomial, barycentric
from solvers._run import Halt, Run
from solvers._start import typical_sizes

KNOWN = {"form": ("ggl", "index2", "index1")}
STAGES = 7
MAX_STAGES = 12  # beyond, the differentiation matrix loses digits
SAFETY, MAX_GROWTH, MIN_SHRINK = 0.9, 2.0, 0.1  # factors on the step's length from one step to the next
NEWTON_SHRINK = 0.5  # factor on the step's length where Newton's iteration fails
STEPS_WITHOUT_GROWTH = 20  # steps without growth after a rejection
MIN_GROWTH = 1.3  # smaller growth is not made, to keep the factorised matrix
FIRST_STEP = 1e-4  # first step tried, as a share of the interval
END_POWER = 0.75  # the last Legendre coefficient may be rtol**END_POWER, as a step's end is far more accurate
MAX_ITERATIONS = 20  # of the simplified Newton iteration, which gains one to five digits each
OLD_CONTRACTION = 0.1  # contraction with an earlier step's matrix above which a new matrix is made
MAX_CONTRACTION = 0.5  # contraction with a new matrix above which the step is too long
UNJUDGED = 3  # first increments not used for the contraction: they correct the guess of the multipliers
ROUNDOFF = 1e-15  # increments below this, relative to the sizes, change nothing
MIN_SIZE = 1e-2  # lower bound on a coordinate's size, relative to the largest coordinate
STAGNATION = 1e-13  # increments with a new matrix below this that no longer shrink are roundoff in the defect
EPS = float(np.finfo(np.float64).eps)
NOISE_SAFETY = 2.0  # one sample of roundoff may be smaller than another


@dataclass(frozen=True)
class CollocationSolver(Adapter):
    """Radau IIA on a DAE form.  Every output time ends a step, so rows are as accurate as steps but shorten them."""

    stages: int = STAGES
    library: ClassVar[str] = "hhtbench"

    def drive(self, run: Run) -> None:
        """Take steps with error control by the decay of the collocation polynomial's Legendre coefficients."""
        method = Collocation(run=run, nodes=radau_nodes(self.stages), scales=_scales(run), rate=run.start.yp)
        run.tells_no_steps()
        weights = np.where(run.form.multipliers, np.inf, run.weights)
        length, patience = FIRST_STEP * abs(run.t1 - run.t0), 0
        while run.unfinished():
            end = _end_of_step(run, length)
            h = end - run.t
            if h == 0:
                raise Halt(Status.step_too_small, f"{Status.step_too_small.text} t = {exact(run.now)} was reached.")
            z = method.step(run.t, run.y, h)
            factor = self._growth(z, method, weights + run.rtol * np.abs(run.y), run.rtol)
            if z is None or factor < SAFETY:
                run.work.add("steps_rejected_newton" if z is None else "steps_rejected_error")
                length, patience = abs(h) * factor, STEPS_WITHOUT_GROWTH
                continue
            method.advance(z, h)
            dense = partial(method.interpolant, run.t, run.y, z, h)
            run.accept(end, run.y + z[-1], _no_interior, dense=dense)
            run.work.library = dict(method.tally)
            patience = max(patience - 1, 0)
            if factor > MIN_GROWTH and not patience:
                length = max(length, abs(h) * factor)

    def _growth(self, z: Matrix | None, method: Collocation, sizes: Vector, rtol: float) -> float:
        """Factor from this step's length to the next one's; below SAFETY this step is rejected."""
        if z is None:
            return NEWTON_SHRINK
        error = np.max(np.abs(method.nodes.leading @ z) / sizes) * rtol ** (1 - END_POWER)
        return float(np.clip(SAFETY * max(error, 1e-99) ** (-1 / self.stages), MIN_SHRINK, MAX_GROWTH))


def _scales(run: Run) -> Vector:
    """Typical sizes of y, (size,): the problem's for q and v, one elsewhere."""
    scales, known = np.ones(run.form.size), typical_sizes(run.problem)
    scales[: known.size] = known
    return scales


def _end_of_step(run: Run, length: float) -> float:
    """End time of a step of about ``length`` from run.t: the next output time, or halfway to it if that is near."""
    stops = np.array([run.t1]) if run.wanted is None else np.append(run.wanted, run.t1)
    stop = float(next(t for t in stops if run.direction * t > run.direction * run.t))
    rest = abs(stop - run.t)
    if rest <= length * (1 + 1e-9):
        return stop
    return run.t + run.direction * min(length, rest / 2)


def _no_interior(time: float) -> Any:
    raise AssertionError("every output time is the end of a step")


@dataclass(frozen=True)
class Nodes:
    """Collocation nodes on [0, 1] and the matrices derived from them."""

    c: Vector  #: (s,) nodes; the last is 1
    slope: Matrix  #: (s, s) values at the nodes less that at the start -> derivatives at the nodes
    roots: NDArray[np.complex128]  #: (r,) eigenvalues of ``slope``, one of each conjugate pair
    to_modes: NDArray[np.complex128]  #: (r, s) values at the nodes -> coefficients of the eigenvectors of ``roots``
    from_modes: NDArray[np.complex128]  #: (s, r) these coefficients -> values at the nodes, as the real part
    leading: Vector  #: (s,) values at the nodes -> last Legendre coefficient


@cache
def radau_nodes(stages: int) -> Nodes:
    """The nodes of Radau IIA with ``stages`` stages."""
    inner = np.sort(special.roots_jacobi(stages - 1, 1.0, 0.0)[0]) if stages > 1 else np.zeros(0)
    c = np.append((1 + inner) / 2, 1.0)
    x = np.append(0.0, c)
    weight, difference = barycentric(x), x[:, None] - x[None, :] + np.eye(stages + 1)
    slope = weight[None, :] / weight[:, None] / difference
    np.fill_diagonal(slope, 0.0)
    np.fill_diagonal(slope, -slope.sum(axis=1))
    monomial = weight[1:]  # coefficient of x^s: the divided difference of all points
    legendre = 1 / special.comb(2 * stages, stages, exact=False)  # P_s on [0, 1] begins with comb(2s, s) x^s
    roots, vectors = linalg.eig(slope[1:, 1:])
    kept = roots.imag >= 0
    return Nodes(
        c=c,
        slope=slope[1:, 1:],
        roots=roots[kept],
        to_modes=linalg.inv(vectors)[kept],
        from_modes=vectors[:, kept] * np.where(roots[kept].imag > 0, 2.0, 1.0),
        leading=monomial * legendre,
    )


@dataclass
class Collocation:
    """Steps of the collocation method on the DAE form of a run; reuses its factorised matrix while it contracts."""

    run: Any
    nodes: Nodes
    scales: Vector  #: (size,) typical sizes of y; those of multipliers are not used
    rate: Vector  #: (size,) dy/dt at the end of the last step
    last: tuple[Matrix, float] | None = None  #: change of y at the nodes of the last step, and its length [s]
    factor: Any = None
    factor_h: float = 0.0
    noise: float = ROUNDOFF  #: size of increments due to roundoff in the defect
    tally: Counter[str] = field(default_factory=Counter)  #: Newton iterations, factorisations and solves so far

    def step(self, t: float, y: Vector, h: float) -> Matrix | None:
        """Change of y at the nodes, (s, size), in a step of length ``h`` from (t, y); None if Newton's iteration fails."""
        guess = self._predicted(y.size, h)
        if self.factor is not None and self.factor_h == h:
            found = self._iterate(t, y, h, guess, OLD_CONTRACTION, self.noise)
            if found is not None:
                return found
        self._factorise(t, y, h, guess)
        return self._iterate(t, y, h, guess, MAX_CONTRACTION, max(self.noise, STAGNATION))

    def advance(self, z: Matrix, h: float) -> None:
        """Note that the step with the changes ``z`` (s, size) was accepted."""
        self.last, self.rate = (z, h), self.nodes.slope[-1] @ z / h

    def interpolant(self, t: float, y: Vector, z: Matrix, h: float) -> Polynomial:
        """Collocation polynomial of the step from (t, y) with the changes ``z`` (s, size)."""
        return Polynomial(t + h * np.append(0.0, self.nodes.c), np.vstack([y, y + z]))

    def _predicted(self, size: int, h: float) -> Matrix:
        """Guess (s, size) of the changes by extrapolating the last step's polynomial."""
        if self.last is None:
            return self.nodes.c[:, None] * h * self.rate
        z, length = self.last
        return extrapolation(self.nodes, h / length) @ z

    def _iterate(self, t: float, y: Vector, h: float, z: Matrix, contraction: float, noise: float) -> Matrix | None:
        """Simplified Newton iteration to roundoff; None if increments shrink by less than ``contraction``.

        Increments below ``noise`` that no longer shrink count as roundoff in the defect.
        """
        residual, form = self.run.residual, self.run.form
        counted = ~form.multipliers  # multipliers follow the others
        times, last, sizes = t + self.nodes.c * h, np.inf, self._sizes(y)
        for iteration in range(MAX_ITERATIONS):
            stages = zip(times, z, self.nodes.slope @ z / h, strict=True)
            defect = np.array([residual(time, y + change, rate) for time, change, rate in stages])
            if not np.isfinite(defect).all():
                return None
            increment = self._solved(defect)
            self.tally.update(newton_iterations=1, linear_solves=1)
            z = z - increment
            size = float(np.max((np.abs(increment) / sizes)[:, counted]))
            judged = iteration >= UNJUDGED
            if size <= ROUNDOFF or (judged and MAX_CONTRACTION * last < size <= noise):
                return z
            if not np.isfinite(size) or (judged and size > max(contraction * last, noise)):
                return None
            last = size
        return None

    def _sizes(self, y: Vector) -> Vector:
        """Sizes (size,) that increments are measured by; small coordinates carry the roundoff of the largest one."""
        sizes, n = self.scales + np.abs(y), self.run.form.blocks["q"].stop
        for block in (slice(0, n), slice(n, 2 * n)):
            sizes[block] = np.maximum(sizes[block], MIN_SIZE * np.max(sizes[block]))
        return sizes

    def _factorise(self, t: float, y: Vector, h: float, guess: Matrix) -> None:
        """Factorise the step's matrix slope_ij / h dF/dy' + delta_ij dF/dy, with derivatives from its middle node.

        The eigenvectors of ``slope`` split it into a block ``root / h dF/dy' + dF/dy`` per eigenvalue: (IV.8.5) of Hairer
        and Wanner.
        """
        middle = self.nodes.c.size // 2
        place = t + self.nodes.c[middle] * h, y + guess[middle], self.nodes.slope[middle] @ guess / h
        direct, other = (self.run.form.matrix(self.run.jacobian(*place, c)) for c in (0.0, 1.0))
        blocks = [direct + root / h * (other - direct) for root in self.nodes.roots]
        self.factor, self.factor_h = [linalg.lu_factor(block, check_finite=False) for block in blocks], h
        self.tally.update(factorisations=1)
        self.noise = self._noise(np.abs(direct) @ np.abs(place[1]) + np.abs(other - direct) @ np.abs(place[2]), y)

    def _noise(self, terms: Vector, y: Vector) -> float:
        """Size of increments due to roundoff of the ``terms`` (size,) of the equations; at most rtol.

        In a stiff system this is far above the roundoff of y: that of a spring's force grows with its stiffness.
        """
        bits = EPS * terms * np.random.default_rng(0).choice([-1.0, 1.0], (self.nodes.c.size, y.size))
        size = np.max((np.abs(self._solved(bits)) / self._sizes(y))[:, ~self.run.form.multipliers])
        return min(NOISE_SAFETY * float(size), float(self.run.rtol))

    def _solved(self, defect: Matrix) -> Matrix:
        """Solve with the factorised matrix for ``defect`` (s, size)."""
        modes = zip(self.factor, self.nodes.to_modes @ defect, strict=True)
        solved = [linalg.lu_solve(factor, part, check_finite=False) for factor, part in modes]
        return np.asarray((self.nodes.from_modes @ np.array(solved)).real)


def extrapolation(nodes: Nodes, ratio: float) -> Matrix:
    """(s, s) matrix: changes at the nodes of one step -> changes at those of the next, ``ratio`` times as long."""
    x = np.append(0.0, nodes.c)
    weight = barycentric(x)
    parts = weight / (1 + ratio * nodes.c[:, None] - x)
    lagrange = parts / parts.sum(axis=1, keepdims=True)
    lagrange[:, -1] -= 1.0
    return lagrange[:, 1:]


def solver(**options: Any) -> CollocationSolver:
    """Radau IIA; options ``form``: ggl (default), index2 or index1, ``stages``: 7, order 2 stages - 1."""
    stages = positive_integer("stages", options.pop("stages", STAGES))
    if not 2 <= stages <= MAX_STAGES:
        raise ProblemError(f"stages must be from 2 to {MAX_STAGES}; got {stages}.")
    chosen = choose("collocation", options, KNOWN)
    return CollocationSolver(f"collocation(form={chosen['form']}, stages={stages})", chosen["form"], "radau", stages)
