"""Mechanisms of rigid bodies, joints and forces by name: :class:`~hhtbench.mechanics.multibody.mechanism.Mechanism`."""
