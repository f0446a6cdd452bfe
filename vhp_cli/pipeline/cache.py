"""Results kept between runs, keyed by the content of the inputs.

One JSON file per model: a re-check reads one file, and whatever the last run did not use is dropped, so
the cache can't outgrow its models. A damaged or foreign file counts as empty: the cache can cost time,
never a verdict.
"""

from __future__ import annotations

import hashlib
import json
import os
import time
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from vhp_cli import __version__
from vhp_cli.formats.atomic import write_atomically

_KEEP_DAYS = 60


def default_directory() -> Path:
    """Return where caches live: ``$VHP_CACHE_DIR``, else ``vhp`` in the user's cache directory."""
    if chosen := os.environ.get("VHP_CACHE_DIR"):
        return Path(chosen)
    base = os.environ.get("XDG_CACHE_HOME")
    return (Path(base) if base else Path.home() / ".cache") / "vhp"


def _code_stamp() -> str:
    """Identify the code that measures: by version, and by its files, which differ within a version in a checkout."""
    package = Path(__file__).resolve().parents[1]
    files = [package / "mesh.py"]
    for floor in ("formats", "inspection", "kernels"):
        files += sorted(path for path in (package / floor).iterdir() if path.suffix in (".py", ".so", ".dylib", ".dll"))
    facts = [(path.name, path.stat().st_size, path.stat().st_mtime_ns) for path in files]
    return f"{__version__} {hashlib.sha256(repr(facts).encode()).hexdigest()[:16]}"


class Cache:
    """Results by section and key; only what was asked for or added in this run is saved.

    Parameters
    ----------
    directory
        Where the file lies; None switches the cache off.
    paths
        The paths of the model, which name the file.
    """

    def __init__(self, directory: Path | None, paths: Iterable[Path]) -> None:
        self._stamp = _code_stamp()
        self._old: dict[str, dict[str, Any]] = {}
        self._new: dict[str, dict[str, Any]] = {}
        self._path: Path | None = None
        self._changed = False
        if directory is not None:
            identity = "\n".join(sorted(str(path.resolve()) for path in paths))
            self._path = directory / f"{hashlib.sha256(identity.encode(errors='surrogateescape')).hexdigest()[:32]}.json"
            self._old = self._load(self._path)

    def get(self, section: str, key: str) -> Any:
        """Return the stored result, None if there is none."""
        found = self._old.get(section, {}).get(key)
        if found is not None:
            self._new.setdefault(section, {})[key] = found
        return found

    def put(self, section: str, key: str, result: Any) -> None:
        """Store a JSON value."""
        self._changed = True
        if self._path is not None:
            self._new.setdefault(section, {})[key] = result

    def save(self) -> None:
        """Write what this run used, if anything is new; a cache that can't be written is left out."""
        if self._path is None or not self._changed:
            return
        try:
            self._path.parent.mkdir(parents=True, exist_ok=True)
            document = {"stamp": self._stamp, "sections": self._new}
            write_atomically(self._path, json.dumps(document, separators=(",", ":")).encode())
            oldest = time.time() - _KEEP_DAYS * 86400
            for file in self._path.parent.glob("*.json"):
                if file.stat().st_mtime < oldest:
                    file.unlink(missing_ok=True)
        except OSError:
            return

    def _load(self, path: Path) -> dict[str, dict[str, Any]]:
        try:
            document = json.loads(path.read_bytes())
        except (OSError, ValueError):
            return {}
        if not isinstance(document, dict) or document.get("stamp") != self._stamp:
            return {}
        sections = document.get("sections")
        return sections if isinstance(sections, dict) else {}
