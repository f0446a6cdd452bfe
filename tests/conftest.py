from __future__ import annotations

import importlib
from pathlib import Path
from types import ModuleType

import pytest

SHARED_DATA = Path(__file__).resolve().parents[2] / "shared" / "data"


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--slow", action="store_true", help="run the tests marked slow too")
    parser.addoption("--update-golden", action="store_true", help="write the expected report files anew")


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    # `-m slow` asks for them by name.
    if config.getoption("--slow") or "slow" in str(config.getoption("-m")):
        return
    skip = pytest.mark.skip(reason="slow: runs with --slow")
    for item in items:
        if "slow" in item.keywords:
            item.add_marker(skip)


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Folder of real and broken example meshes, which are not part of the repository."""
    if not SHARED_DATA.is_dir():
        pytest.skip("the example meshes are not beside this checkout")
    return SHARED_DATA


@pytest.fixture(scope="session")
def pymeshlab() -> ModuleType:
    """Skip where the system libraries that pymeshlab loads are missing."""
    try:
        return importlib.import_module("pymeshlab")
    except ImportError as error:
        pytest.skip(f"pymeshlab can't be imported: {error}; try `make system-libraries`")
