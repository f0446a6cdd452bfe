"""The house: a floor imports from floors below it only, and no import goes in a circle."""

from __future__ import annotations

import ast
from graphlib import TopologicalSorter
from pathlib import Path

PACKAGE = Path(__file__).resolve().parents[1] / "vhp_cli"
# From the ground up, as in docs/design.md; rooms on one floor may use each other.
FLOORS = (
    {"errors", "rounding", "__init__"},
    {"measures", "mesh", "volume", "rules", "processes", "kernels"},
    {"config", "tissues", "model", "gate", "gate_tetmesh", "formats", "inspection", "engines", "report"},
    {"phantom", "stages"},
    {"pipeline"},
    {"commands"},
    {"cli"},
    {"__main__", "child"},
)
LEVEL = {room: level for level, rooms in enumerate(FLOORS) for room in rooms}


def _name(path: Path) -> str:
    parts = path.relative_to(PACKAGE.parent).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


MODULES = {_name(path): path for path in sorted(PACKAGE.rglob("*.py"))}


def _imports(module: str, *, whole: bool) -> set[str]:
    """Return the modules of the package that a module names in imports: all of them, or those run on import."""
    tree = ast.parse(MODULES[module].read_text(encoding="utf-8"))
    found = set()
    pending: list[ast.AST] = [tree]
    while pending:
        node = pending.pop()
        if isinstance(node, ast.Import):
            found.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{module} has a relative import"
            base = node.module or ""
            found.update(f"{base}.{alias.name}" if f"{base}.{alias.name}" in MODULES else base for alias in node.names)
        if not whole and (isinstance(node, ast.FunctionDef) or _is_for_types(node)):
            continue
        pending.extend(ast.iter_child_nodes(node))
    return {name for name in found if name in MODULES and name != module}


def _is_for_types(node: ast.AST) -> bool:
    return isinstance(node, ast.If) and isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING"


def _room(module: str) -> str:
    return [*module.split("."), "__init__"][1]


def test_every_room_has_a_floor():
    assert {_room(name) for name in MODULES} == set(LEVEL)


def test_imports_go_down():
    upward = [
        f"{module} imports {found}"
        for module in MODULES
        for found in _imports(module, whole=True)
        if LEVEL[_room(found)] > LEVEL[_room(module)]
    ]
    assert not upward


def test_imports_never_circle():
    TopologicalSorter({name: _imports(name, whole=False) for name in MODULES}).prepare()
