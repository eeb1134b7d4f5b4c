"""Formulas at a few directions: programs are not worth optimising."""

import pytest


@pytest.fixture(scope="module", autouse=True)
def quickly(compiled_quickly):
    """As its name says, in every module here."""
