"""
Steps by hand, and a checkpoint
===============================

As with SUNDIALS: ``init_step``, then ``step`` to a time.  A checkpoint goes on later, bit by bit.
"""

import matplotlib.pyplot as plt
import numpy as np

import hhtbench as hb

pendulum = hb.load_problem("simple_pendulum")
hht = hb.HHT(pendulum.system, rho_inf=0.9)
hht.init_step(0.0, pendulum.q0, pendulum.v0, rtol=1e-3)
path = []
while hht.state.t < 2.0:
    hht.step(2.0)
    path.append(hht.state.q)
saved = hht.checkpoint()

other = hb.HHT(pendulum.system, rho_inf=0.9)
other.resume(saved)
for integrator in (hht, other):
    integrator.step(3.0, "normal")
print("the same bits after a restart:", np.array_equal(hht.state.q, other.state.q), "at t =", other.state.t)

figure, axes = plt.subplots(layout="constrained")
rows = np.array(path)
axes.plot(rows[:, 0], rows[:, 1], ".-")
axes.set(xlabel="x [m]", ylabel="y [m]", title=f"{len(rows)} steps", aspect="equal")
