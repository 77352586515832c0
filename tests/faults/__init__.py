"""Faults planted into copies of the sources: do the checks of ``hhtbench.conformance`` find them?"""
