"""Check a model: every tissue by itself, then every pair that is near, then the model as a whole."""

from __future__ import annotations

import os
import sys
import threading
import time
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from vhp_cli import __version__, formats
from vhp_cli.config import Settings
from vhp_cli.errors import UnreadableFileError, UsageError, VhpError
from vhp_cli.gate import failure_findings, model_findings, pair_findings, sort_findings, tissue_findings
from vhp_cli.inspection.nesting import nesting
from vhp_cli.inspection.proximity import inspect_pair, near_pairs
from vhp_cli.inspection.tissue import Surface, inspect_nothing, restore_surface
from vhp_cli.measures import Defects, Finding, PairMeasures, PairRecord, Report, TissueMeasures, TissueRecord
from vhp_cli.model import Model, TissueFile
from vhp_cli.pipeline.cache import Cache, file_facts
from vhp_cli.pipeline.measuring import (
    Issue,
    geometry_key,
    issues_of,
    measure,
    number_in_file,
    parse_in_mm,
    shape_limits,
    unreadable,
)

SCHEMA = "vhp-report/1"

# Boxes in the report are rounded to a nanometre; the pair tests decide, so a little too near costs nothing.
_BOX_ROUNDING_MM = 1e-5

Progress = Callable[[str, int, int], None]
_Task = tuple[Callable[..., Any], tuple[Any, ...]]


@dataclass(slots=True)
class _Tissue:
    """One tissue on its way through the check."""

    source: TissueFile
    sha256: str = ""
    format: str = ""
    issues: list[Issue] = field(default_factory=list)
    measures: TissueMeasures = field(default_factory=inspect_nothing)
    defects: Defects = field(default_factory=dict)
    surface: Surface | None = None
    face_number: np.ndarray | None = None  # of each face of the mesh in the file, where they differ
    failed: bool = False
    lock: threading.Lock = field(default_factory=threading.Lock)


@dataclass(frozen=True, slots=True)
class Checked:
    """The report of a check, and whether a tissue or pair could not be processed."""

    report: Report
    failed: bool


def check_model(
    model: Model,
    settings: Settings,
    *,
    paths: Sequence[Path] = (),
    jobs: int | None = None,
    cache_directory: Path | None = None,
    progress: Progress | None = None,
) -> Checked:
    """Check every tissue and every near pair of a model.

    The result does not depend on the number of threads: every task is a pure function of its input, and
    results are put in the order of the files.

    Parameters
    ----------
    model
        The tissues, from `vhp_cli.model.find_model`.
    settings
        What to check and how to judge it.
    paths
        The model as named by the user, for the report.
    jobs
        Threads; None: one per available core.
    cache_directory
        Where results are kept between runs; None: nowhere.
    progress
        Called with step, number done and number in all.

    Raises
    ------
    UsageError
        If not one file could be read.
    """
    started, clock = datetime.now(UTC), _Clock()
    threads = jobs or available_cores()
    cache = Cache(cache_directory, paths or [file.path for file in model.tissues])
    tissues = [_Tissue(file) for file in model.tissues]
    executor = ThreadPoolExecutor(threads, thread_name_prefix="vhp")
    try:
        # The largest first, so that no long task is left for the end.
        by_size = sorted(tissues, key=lambda tissue: -_size(tissue.source.path))
        _run(executor, [(_inspect, (tissue, settings, cache)) for tissue in by_size], "tissues", progress)
        clock.lap("tissues")
        if not any(tissue.format or tissue.failed for tissue in tissues):
            raise UsageError(_nothing_readable(tissues))
        pairs = _check_pairs(executor, tissues, settings, cache, progress)
        clock.lap("pairs")
    finally:
        executor.shutdown(wait=False, cancel_futures=True)
        cache.save()
    report = _report(tissues, pairs, model.unread, settings, paths)
    clock.lap("report")
    report["run"] = _run_facts(started, clock, threads)
    failed = any(tissue.failed for tissue in tissues) or any(isinstance(pair, tuple) for pair in pairs)
    return Checked(report, failed)


def available_cores() -> int:
    """Return the number of cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


class _Clock:
    def __init__(self) -> None:
        self._last = time.perf_counter()
        self.seconds: dict[str, float] = {}

    def lap(self, step: str) -> None:
        now = time.perf_counter()
        self.seconds[step] = round(now - self._last, 4)
        self._last = now


def _run(executor: ThreadPoolExecutor, tasks: Iterable[_Task], step: str, progress: Progress | None) -> None:
    """Run tasks that keep their results themselves; the first unexpected exception ends the run."""
    futures = [executor.submit(function, *arguments) for function, arguments in tasks]
    for done, future in enumerate(futures, start=1):
        future.result()
        if progress:
            progress(step, done, len(futures))


def _inspect(tissue: _Tissue, settings: Settings, cache: Cache) -> None:
    name = tissue.source.name
    limits = shape_limits(settings, name)
    try:
        tissue.sha256, data = _identify(tissue.source.path, cache)
        key = f"{_content(tissue)} {geometry_key(settings)} {limits}"
        kept = cache.get("tissues", key)
        if kept is None:
            reading = parse_in_mm(tissue.source.path, _unchanged_bytes(tissue) if data is None else data, settings)
            tissue.face_number = reading.face_number
            measures, defects, tissue.surface = measure(reading, limits)
            issues = [[issue.rule, issue.count, issue.detail] for issue in issues_of(reading)]
            kept = {"format": reading.format, "issues": issues, "measures": measures, "defects": defects}
            cache.put("tissues", key, kept)
        tissue.format, tissue.measures, tissue.defects = kept["format"], kept["measures"], kept["defects"]
        tissue.issues = [Issue(*issue) for issue in kept["issues"]]
    except UnreadableFileError as error:
        tissue.issues = [unreadable(error)]
    except Exception as error:
        # Whatever goes wrong with one tissue, the others are still checked, and the exit code says so.
        tissue.failed = True
        tissue.issues = [Issue("F012", 1, f"{type(error).__name__}: {error}")]


def _identify(path: Path, cache: Cache) -> tuple[str, bytes | None]:
    """Return the SHA-256 of a file and its contents; None if these did not have to be read."""
    facts = file_facts(path)
    known = cache.get("files", str(path))
    if facts is not None and known is not None and known["facts"] == facts:
        return known["sha256"], None
    data = formats.read_bytes(path)
    sha256 = formats.sha256(data)
    if facts is not None:
        cache.put("files", str(path), {"facts": facts, "sha256": sha256})
    return sha256, data


def _unchanged_bytes(tissue: _Tissue) -> bytes:
    data = formats.read_bytes(tissue.source.path)
    if formats.sha256(data) != tissue.sha256:
        raise VhpError(f"{tissue.source.file} changed while it was being checked", hint="run the check again")
    return data


def _surface(tissue: _Tissue, settings: Settings) -> Surface:
    """Return the surface of a tissue, read again if its measures came from the cache."""
    with tissue.lock:
        if tissue.surface is None:
            reading = parse_in_mm(tissue.source.path, _unchanged_bytes(tissue), settings)
            tissue.face_number = reading.face_number
            tissue.surface = restore_surface(reading.mesh, tissue.measures)
        return tissue.surface


def _check_pairs(
    executor: ThreadPoolExecutor,
    tissues: Sequence[_Tissue],
    settings: Settings,
    cache: Cache,
    progress: Progress | None,
) -> list[PairRecord | tuple[str, str, str]]:
    """Return the record of each near pair in order, or (a, b, error) where it could not be processed."""
    solid = [tissue for tissue in tissues if tissue.measures["bounds_mm"]]
    if len(solid) < 2:
        return []
    search = _gap_search(settings, [tissue.source.name for tissue in solid])
    boxes = [tissue.measures["bounds_mm"] for tissue in solid]
    lower, upper = (np.array([box[side] for box in boxes if box]) for side in ("min", "max"))
    candidates = near_pairs(lower, upper, search + _BOX_ROUNDING_MM)
    results: list[PairRecord | tuple[str, str, str] | None] = [None] * len(candidates)

    def one(index: int) -> None:
        a, b = (solid[tissue] for tissue in candidates[index])
        key = f"{_content(a)} {_content(b)} {geometry_key(settings)} {search!r}"
        try:
            kept = cache.get("pairs", key)
            if kept is None:
                found = inspect_pair(_surface(a, settings), _surface(b, settings), search)
                if found is not None and found["faces"] is not None:
                    found["faces"] = [
                        number_in_file(tissue.face_number, face)
                        for tissue, face in zip((a, b), found["faces"], strict=True)
                    ]
                kept = {"measures": found}
                cache.put("pairs", key, kept)
            measures: PairMeasures | None = kept["measures"]
            if measures is not None:
                results[index] = {"a": a.source.name, "b": b.source.name, **measures}
        except Exception as error:
            results[index] = (a.source.name, b.source.name, f"{type(error).__name__}: {error}")

    def some(indices: Sequence[int]) -> None:
        for index in indices:
            one(index)

    # Pairs of large tissues first; a few pairs a task, so that the queue costs little.
    cost = np.array([tissue.measures["triangles"] for tissue in solid])
    order = np.argsort(-cost[candidates].sum(axis=1), kind="stable").tolist()
    tasks = [(some, (order[start : start + 4],)) for start in range(0, len(order), 4)]
    _run(executor, tasks, "pairs", progress)
    return [result for result in results if result is not None]


def _report(
    tissues: Sequence[_Tissue],
    pairs: Sequence[PairRecord | tuple[str, str, str]],
    unread: Sequence[str],
    settings: Settings,
    paths: Sequence[Path],
) -> Report:
    records: list[TissueRecord] = []
    findings: list[Finding] = []
    for tissue in tissues:
        source = tissue.source
        findings += tissue_findings(
            source.name, tissue.measures, tissue.defects, tissue.issues, source.clashes, settings
        )
        records.append(
            {
                "name": source.name,
                "file": source.file,
                "sha256": tissue.sha256,
                "format": tissue.format,
                "tissue_type": settings.tissue_type(source.name),
                **tissue.measures,  # type: ignore[typeddict-item]
                "findings": [],
            }
        )
    near = [pair for pair in pairs if isinstance(pair, dict)]
    for pair in near:
        findings += pair_findings(pair, settings)
    for a, b, error in (pair for pair in pairs if isinstance(pair, tuple)):
        findings += failure_findings(a, b, error, settings)
    findings += model_findings(records, near, unread, settings)
    names = [record["name"] for record in records]
    volumes = {record["name"]: abs(record["volume_mm3"]) for record in records}
    report: Report = {
        "schema": SCHEMA,
        "tool": {"name": "vhp", "version": __version__},
        "command": "check",
        "settings": settings.as_dict(),
        "model": {"paths": [path.as_posix() for path in paths], "units": settings.units},
        "summary": {
            "passed": True,
            "tissues": len(records),
            "triangles": sum(record["triangles"] for record in records),
            "pairs": len(near),
            "errors": 0,
            "warnings": 0,
            "notes": 0,
            "counts": {},
        },
        "tissues": records,
        "pairs": near,
        "nesting": nesting(names, near, volumes),
        "findings": [],
        "run": {},
    }
    return with_findings(report, sort_findings(findings, names))


def with_findings(report: Report, findings: list[Finding]) -> Report:
    """Return a report with these findings, counted and judged: known ones do not fail it."""
    by_tissue: dict[str, list[Finding]] = {}
    counts: dict[str, int] = {}
    for finding in findings:
        counts[finding["rule"]] = counts.get(finding["rule"], 0) + 1
        if len(finding["tissues"]) == 1:
            by_tissue.setdefault(finding["tissues"][0], []).append(finding)
    levels = [finding["level"] for finding in findings]
    return {
        **report,
        "summary": {
            **report["summary"],
            "passed": not any(finding["level"] == "error" and not finding.get("known") for finding in findings),
            "errors": levels.count("error"),
            "warnings": levels.count("warning"),
            "notes": levels.count("note"),
            "counts": dict(sorted(counts.items())),
        },
        "tissues": [{**record, "findings": by_tissue.get(record["name"], [])} for record in report["tissues"]],
        "findings": findings,
    }


def _gap_search(settings: Settings, names: Sequence[str]) -> float:
    """Return how far gaps are measured: at least as far as the gap rule looks."""
    limits = [settings.rule("P005", name) for name in names]
    needed = (setting.limit for setting in limits if setting.level and setting.limit is not None)
    return max(settings.gap_search_mm or 0.0, *needed, 0.0)


def _content(tissue: _Tissue) -> str:
    """Identify what was read: the bytes, and the format that the suffix names."""
    return f"{tissue.sha256} {tissue.source.path.suffix.lower()}"


def _size(path: Path) -> int:
    try:
        return path.stat().st_size
    except OSError:
        return 0


def _nothing_readable(tissues: Sequence[_Tissue]) -> str:
    lines = [f"{tissue.source.path}: {issue.detail}" for tissue in tissues for issue in tissue.issues]
    shown = lines[:10] + ([f"and {len(lines) - 10} more"] if len(lines) > 10 else [])
    return "no file of the model can be read:\n  " + "\n  ".join(shown)


def _run_facts(started: datetime, clock: _Clock, threads: int) -> dict[str, object]:
    facts: dict[str, object] = {
        "started": started.isoformat(timespec="seconds"),
        "seconds": {**clock.seconds, "total": round(sum(clock.seconds.values()), 4)},
        "jobs": threads,
        "platform": sys.platform,
        "versions": {"python": sys.version.split()[0], "numpy": np.__version__},
    }
    if sys.platform != "win32":
        import resource

        unit = 2**20 if sys.platform == "darwin" else 2**10
        facts["peak_memory_mb"] = round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / unit, 1)
    return facts
