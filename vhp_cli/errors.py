"""Exceptions of vhp: raised where the fact is known, turned into words at the front door."""

from __future__ import annotations

from pathlib import Path


class VhpError(Exception):
    """Base of every error that vhp raises on purpose.

    Parameters
    ----------
    message
        What is wrong, in one sentence.
    hint
        What the user can do about it.
    """

    def __init__(self, message: str, *, hint: str = "") -> None:
        super().__init__(message)
        self.message = message
        self.hint = hint


class UsageError(VhpError):
    """The command line or the configuration can't be carried out (exit code 2)."""


class UnreadableFileError(VhpError):
    """A mesh file holds nothing that could be checked.

    Parameters
    ----------
    path
        The file.
    message, hint
        As for `VhpError`.
    where
        Place in the file, such as ``"byte 84"`` or ``"line 12"``; empty if it is the file as a whole.
    """

    def __init__(self, path: Path, message: str, *, where: str = "", hint: str = "") -> None:
        super().__init__(message, hint=hint)
        self.path = path
        self.where = where


class NoRoomError(VhpError):
    """The disk is full, or a quota or limit of file size is reached: the work can't go on (exit code 3)."""


class KernelError(VhpError):
    """The compiled kernels are missing, of another version, or out of memory."""
