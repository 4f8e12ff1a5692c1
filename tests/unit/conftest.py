"""Of the tests of the library: what is dear and asked for by several of them."""

import os

import pytest

from scene_plans import ScenePlans


@pytest.fixture(scope="session")
def scene_plan(tmp_path_factory: pytest.TempPathFactory) -> ScenePlans:
    """Plans a sample scene, once in a session."""
    folder = tmp_path_factory.getbasetemp()
    # With several workers each has a folder of its own in that of the session.
    return ScenePlans((folder.parent if "PYTEST_XDIST_WORKER" in os.environ else folder) / "plans")
