"""Hand the result for one tissue over: its file first, then the line that says it is there."""

from __future__ import annotations

import time
from pathlib import Path

from vhp_cli import formats
from vhp_cli.errors import UnreadableFileError, VhpError
from vhp_cli.formats.atomic import write_atomically
from vhp_cli.model import TissueFile
from vhp_cli.pipeline.journal import Entry, Journal
from vhp_cli.pipeline.task import Result


def deliver(
    result: Result, source: TissueFile, out: Path, file: str, journal: Journal, *, started: float, level: int
) -> None:
    """Write what became of a tissue, or a copy of its input, and note it in the journal.

    Parameters
    ----------
    result
        What became of it.
    source
        The input.
    out, file
        Output directory, and the name of the output below it.
    journal
        Of the run.
    started
        When work on the tissue began, by `time.perf_counter`.
    level
        Of the journal's entry.

    Raises
    ------
    VhpError
        If the input is no longer what was worked on, or the output can't be written.
    """
    data = result.data
    if data is None:
        try:
            data = formats.read_bytes(source.path)
        except UnreadableFileError:
            data = None
    output = ""
    if data is None:
        # A directory, or no permission to read: nothing can be handed on, and nothing old may stay.
        (out / file).unlink(missing_ok=True)
    else:
        output = formats.sha256(data)
        if result.data is None and result.sha256 not in ("", output):
            raise VhpError(f"{source.file} changed while it was being processed", hint="run the command again")
        write_atomically(out / file, data)
    journal.add(
        Entry(
            file,
            result.sha256 or output,
            output,
            result.status,
            result.reason,
            result.actions,
            result.deviation,
            round(time.perf_counter() - started, 3),
            level,
            result.history,
            result.introduced,
        )
    )
