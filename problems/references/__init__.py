"""Certified reference solutions and the plan they are built from (``hhtbench reference build``)."""

from pathlib import Path

PLAN = Path(__file__).with_name("plan.toml")
