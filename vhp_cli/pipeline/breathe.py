"""Make a model breathe: fit or take a sequence, prove it, write its frames, report."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from vhp_cli.config import Settings
from vhp_cli.formats.atomic import atomic_write_bytes, atomic_write_text
from vhp_cli.measures import Breathe, BreathFrame, Report
from vhp_cli.model import Model
from vhp_cli.pipeline.breathing_findings import BreathFacts, reasons_to_reject
from vhp_cli.pipeline.breathing_frames import (
    CURVES,
    FRAMES,
    PAGE,
    PICTURE,
    REJECTED,
    SEQUENCE,
    FrameMaker,
    State,
    directory_names,
    frame_writer,
    prepare,
)
from vhp_cli.pipeline.breathing_model import BreathingModel, load_model
from vhp_cli.pipeline.breathing_report import breathing_report, frame_record
from vhp_cli.pipeline.breathing_scripts import write_scripts
from vhp_cli.pipeline.check import available_cores, check_model
from vhp_cli.pipeline.output import refuse_overlap
from vhp_cli.report.animation import Shown, animation_html
from vhp_cli.report.animation_gif import animation_gif
from vhp_cli.report.curves import curves_svg
from vhp_cli.stages.breathe import scripts
from vhp_cli.stages.breathe.fitting.fit import Fit, FitSettings, fit
from vhp_cli.stages.breathe.mass import Density, MassModel, densities, has_container
from vhp_cli.stages.breathe.matching import motions_of
from vhp_cli.stages.breathe.nesting import parents
from vhp_cli.stages.breathe.options import BreatheOptions
from vhp_cli.stages.breathe.proof import prove
from vhp_cli.stages.breathe.rest import at_rest
from vhp_cli.stages.breathe.sequence import Motion
from vhp_cli.stages.breathe.sequence import Sequence as Breath
from vhp_cli.stages.breathe.sequence_file import format_sequence
from vhp_cli.stages.breathe.time import Moment

Progress = Callable[[str, int, int], None]


@dataclass(frozen=True, slots=True)
class Request:
    """What is to be done.

    Parameters
    ----------
    out
        The output directory; None: nothing is written.
    sequence
        To be played; None: one is fitted.
    with_frames
        Whether frames are written, beside sequence and report.
    overwrite
        Whether results of an earlier run may be replaced.
    scripts
        Programs for which scripts are written beside the frames; None: all of them.
    """

    out: Path | None
    sequence: Breath | None = None
    with_frames: bool = True
    overwrite: bool = False
    scripts: tuple[str, ...] | None = None


@dataclass(frozen=True, slots=True)
class Breathed:
    """The report of a run, and what the user should know of the files beside it."""

    report: Report
    notes: tuple[str, ...] = ()


def run_breathe(
    model: Model,
    options: BreatheOptions,
    settings: Settings,
    request: Request,
    *,
    paths: Sequence[Path],
    jobs: int | None = None,
    cache_directory: Path | None = None,
    progress: Progress | None = None,
) -> Breathed:
    """Make a model breathe.

    Parameters
    ----------
    model
        The tissues.
    options, settings
        What the breath is to be, and all other settings.
    request
        What is to be done.
    paths
        The model as named by the user.
    jobs
        Threads; None: one per available core.
    cache_directory
        Where measures are kept between runs; None: nowhere.
    progress
        Called with step, number done and number in all.

    Raises
    ------
    UsageError
        If the model can't breathe: no lungs, a mirror image, a wrong unit, a file that can't be read.
    """
    if request.out is not None:
        refuse_overlap(request.out, model, paths)
        prepare(request.out, overwrite=request.overwrite)
    threads = jobs or available_cores()
    clock = _Clock()
    loaded = load_model(model, settings, paths, threads)
    checked = check_model(
        model, settings, paths=paths, jobs=threads, cache_directory=cache_directory, progress=progress
    )
    clock.lap("input")
    around = parents(loaded.tissues)
    known = densities(loaded.tissues, loaded.said, {t.name: settings.tissue_type(t.name) for t in loaded.tissues})
    mass = _mass_model(loaded, around, known, options)
    rest = at_rest(loaded.tissues, options.gap_mm)
    clock.lap("rest")
    fitted: Fit | None = None
    if request.sequence is None:
        fitted = fit(
            loaded.tissues,
            around,
            mass,
            FitSettings(
                options.targets, options.steps, options.gap_mm, options.forward_mm, options.period_s, options.ribs
            ),
            progress,
        )
        sequence = fitted.sequence
        motions = motions_of(sequence, loaded.tissues)
    else:
        sequence = request.sequence
        motions = motions_of(sequence, loaded.tissues, around)
    clock.lap("fit")
    proof = prove(
        rest, motions, sequence.steps, jobs=threads, progress=progress, moved_at_rest=not sequence.identity_at_rest
    )
    clock.lap("proof")
    moments = options.moments(sequence.steps, sequence.period_s)
    with ThreadPoolExecutor(threads, thread_name_prefix="vhp") as executor:
        maker = FrameMaker(loaded, rest, motions, mass, options.gap_mm, executor)
        frames, states = _frames(maker, moments, sequence, loaded, options, settings, request, progress)
    clock.lap("frames")
    facts = BreathFacts(
        loaded,
        sequence,
        motions,
        fitted,
        rest,
        proof,
        mass,
        known,
        options,
        frames,
        states,
        held=has_container(loaded.tissues),
    )
    report = breathing_report(checked.report, facts, settings)
    clock.lap("report")
    report["run"] = {**report["run"], "seconds": clock.seconds | {"total": round(sum(clock.seconds.values()), 4)}}
    notes: list[str] = []
    if request.out is not None:
        atomic_write_text(request.out / SEQUENCE, format_sequence(sequence))
        if request.with_frames:
            targets = scripts.TARGETS if request.scripts is None else request.scripts
            notes.append(write_scripts(request.out, loaded, sequence, motions, frames, targets))
            _write_pictures(request.out, loaded, sequence, motions, report["breathe"])
    return Breathed(report, tuple(note for note in notes if note))


def _write_pictures(
    out: Path, loaded: BreathingModel, sequence: Breath, motions: Mapping[str, Motion], section: Breathe
) -> None:
    """Write the curves, and the page that plays in a browser."""
    shown = []
    for tissue in loaded.tissues:
        motion = motions.get(tissue.name)
        times = [0.0] if motion is None else [0.0, 0.5 * sequence.steps, float(sequence.steps)]
        rest = tissue.mesh.vertices
        states = np.stack([rest if motion is None else motion.apply(rest, t) for t in times])
        shown.append(Shown(tissue.name, tissue.role.part, tissue.mesh.faces, states))
    page = animation_html(sequence.name, shown, section, steps=sequence.steps, period_s=sequence.period_s)
    atomic_write_text(out / CURVES, curves_svg(section))
    atomic_write_text(out / PAGE, page)
    atomic_write_bytes(out / PICTURE, animation_gif(shown, period_s=sequence.period_s))


class _Clock:
    def __init__(self) -> None:
        self._last = time.perf_counter()
        self.seconds: dict[str, float] = {}

    def lap(self, step: str) -> None:
        now = time.perf_counter()
        self.seconds[step] = round(now - self._last, 4)
        self._last = now


def _mass_model(
    loaded: BreathingModel,
    around: Mapping[str, str | None],
    known: Mapping[str, Density],
    options: BreatheOptions,
) -> MassModel:
    closed = {tissue.name: tissue.volume_mm3 for tissue in loaded.tissues if tissue.closed}
    return MassModel(
        around,
        {name: density.kg_per_m3 for name, density in known.items()},
        frozenset(tissue.name for tissue in loaded.tissues if tissue.role.part == "lung"),
        closed,
        options.lung_mass,
    )


def _frames(
    maker: FrameMaker,
    moments: Sequence[Moment],
    sequence: Breath,
    loaded: BreathingModel,
    options: BreatheOptions,
    settings: Settings,
    request: Request,
    progress: Progress | None,
) -> tuple[list[BreathFrame], dict[float, State]]:
    """Make every frame, test it, and write it where it belongs; return records and the states that were met."""
    names = directory_names(moments, sequence.period_s)
    at_start, _ = maker.make(0.0)
    start = replace(at_start, mass_kg=maker.mass.kg(maker.mass.rest_mm3), volumes_mm3=dict(maker.mass.rest_mm3))
    lungs = [tissue.name for tissue in loaded.tissues if tissue.role.part == "lung"]
    low = min(tissue.lower[2] for tissue in loaded.tissues if tissue.role.part == "lung")
    start = replace(start, lowest_mm=float(low))
    levels = sorted({moment.x for moment in moments} | {0.0, float(sequence.steps)})
    states: dict[float, State] = {}
    records: dict[int, BreathFrame] = {}
    writing = request.out if request.with_frames else None
    with frame_writer(writing or Path()) as writer:
        for done, x in enumerate(levels, start=1):
            state, contents = maker.make(x)
            states[x] = state
            reasons = reasons_to_reject(
                state, start, options, held=has_container(loaded.tissues), identity_at_rest=sequence.identity_at_rest
            )
            # What the settings do not count as an error rejects no frame.
            reasons = [code for code in reasons if settings.rule(code).level == "error"]
            for moment, name in zip(moments, names, strict=True):
                if moment.x != x:
                    continue
                folder = REJECTED if reasons else FRAMES
                if writing is not None:
                    writer.write(folder, moment, name, contents)
                directory = f"{folder}/{name}" if writing is not None else ""
                records[moment.index] = frame_record(state, start, moment, directory, reasons, lungs)
            if progress:
                progress("frames", done, len(levels))
        if writing is not None:
            writer.finish(sequence.period_s)
    return [records[index] for index in sorted(records)], states
