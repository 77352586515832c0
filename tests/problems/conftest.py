"""Fixtures for judging the problems."""

import importlib

import pytest

from tests.problems.mechanics import Mechanics, time_derivative


@pytest.fixture
def mechanics():
    return Mechanics


@pytest.fixture
def derivative():
    return time_derivative


@pytest.fixture
def make():
    """make(name, **parameters) -> Problem."""
    return lambda name, **parameters: importlib.import_module(f"problems.{name}").problem(**parameters)
