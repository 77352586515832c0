"""Where the published numbers of the first five problems stand in our states."""

from tests.problems.published import Published

PUBLISHED = {
    "jay_negrut_test1": Published(
        spec="jay_negrut_test1",
        values={"y": lambda s: s.q, "z": lambda s: s.v, "lam": lambda s: s.lam},
    ),
    "jay_negrut_pendulum": Published(
        spec="jay_negrut_pendulum",
        values={
            "y3": lambda s: s.q[2],
            "z3": lambda s: s.v[2],
            "y1y2(2)": lambda s: s.q[:2],
            "lam(2)": lambda s: s.lam,
            "a(2)": lambda s: s.vdot,
        },
        times={"y1y2(2)": 2.0, "lam(2)": 2.0, "a(2)": 2.0},
    ),
    "andrews": Published(
        spec="andrews(t_end=0.05)",
        values={
            "q": lambda s: s.q,
            "v": lambda s: s.v,
            "a": lambda s: s.vdot,
            "lam": lambda s: s.lam,
            "q_t2": lambda s: s.q,
            "v_t2": lambda s: s.v,
        },
        times={"q_t2": 0.05, "v_t2": 0.05},
        left_out={
            "published_q": "the Test Set's own values, to 10 digits: test_andrews.py",
            "published_v": "the same, to 7 digits",
        },
    ),
    "knife_edge": Published(
        spec="knife_edge",
        values={"q": lambda s: s.q, "v": lambda s: s.v, "lam": lambda s: s.mu},
    ),
}
