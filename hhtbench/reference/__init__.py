"""Reference solutions with error bars: two method families on two forms that agree; their disagreement is the bar."""

from hhtbench.reference.auto import certified, reference_of
from hhtbench.reference.certify import Certificate, certify
from hhtbench.reference.plan import Entry, load_plan

__all__ = ["Certificate", "Entry", "certified", "certify", "load_plan", "reference_of"]
