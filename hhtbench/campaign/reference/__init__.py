"""Reference solutions with error bars: two method families on two forms that agree; their disagreement is the bar."""

from hhtbench.campaign.reference.auto import certified, reference_of
from hhtbench.campaign.reference.certify import Certificate, certify
from hhtbench.campaign.reference.plan import Entry, load_plan

__all__ = ["Certificate", "Entry", "certified", "certify", "load_plan", "reference_of"]
