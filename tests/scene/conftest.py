"""Programs here run once, on few directions."""

import pytest


@pytest.fixture(scope="module", autouse=True)
def quickly(compiled_quickly):
    """As its name says, in every module here."""
