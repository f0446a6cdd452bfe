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
from vhp_cli.errors import VhpError
from vhp_cli.formats.atomic import write_atomically

_KEEP_DAYS = 60
_SETTLED_NS = 2 * 10**9


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
            self._path = (
                directory / f"{hashlib.sha256(identity.encode(errors='surrogateescape')).hexdigest()[:32]}.json"
            )
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
            # Copies: after an interruption, tasks that were under way may still add their results.
            sections = {name: dict(results) for name, results in list(self._new.items())}
            body = json.dumps(sections, separators=(",", ":")).encode()
            write_atomically(self._path, self._head(body) + body)
            oldest = time.time() - _KEEP_DAYS * 86400
            for file in self._path.parent.glob("*.json"):
                if file.stat().st_mtime < oldest:
                    file.unlink(missing_ok=True)
        except (OSError, VhpError):
            return

    def _load(self, path: Path) -> dict[str, dict[str, Any]]:
        try:
            data = path.read_bytes()
        except OSError:
            return {}
        body = data[data.find(b"\n") + 1 :]
        if data[: -len(body)] != self._head(body):
            return {}
        sections: dict[str, dict[str, Any]] = json.loads(body)
        return sections

    def _head(self, body: bytes) -> bytes:
        """Return the first line of the file: which code wrote it, and that the rest is whole."""
        return f"vhp-cache {self._stamp} {hashlib.sha256(body).hexdigest()}\n".encode()


def file_facts(path: Path) -> list[int] | None:
    """Return what the file system knows of the contents of a file; None where that can't be trusted.

    As in git: contents can't change without the change time, which no user can set; a file changed within the
    last moments might change again within the resolution of the clock, and is not trusted.
    """
    if os.name == "nt":
        return None
    try:
        facts = path.stat()
    except OSError:
        return None
    if max(facts.st_mtime_ns, facts.st_ctime_ns) > time.time_ns() - _SETTLED_NS:
        return None
    return [facts.st_dev, facts.st_ino, facts.st_size, facts.st_mtime_ns, facts.st_ctime_ns]
