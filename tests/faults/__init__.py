"""Faults planted into copies of the sources: do the checks of ``hhtbench.testing`` find them?"""
