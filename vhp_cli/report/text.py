"""Words and numbers for people: the small change that all text reports share."""

from __future__ import annotations

import math
import re

from vhp_cli.measures import Finding, Place

# What a terminal, an XML parser or a reader's eye must not meet: control characters, lone surrogates (bytes of a
# file name that are no UTF-8), line separators, marks that reorder or hide text, and the non-characters of XML.
_UNSAFE = re.compile(
    "[\x00-\x1f\x7f-\x9f\u00ad\u061c\u180e\u200b\u200e\u200f\u2028-\u202e\u2060-\u206f\ufeff\ufff9-\ufffb\ufffe\uffff"
    "\ud800-\udfff\U000e0000-\U000e007f]"
)


def _escape(match: re.Match[str]) -> str:
    code = ord(match.group())
    if 0xDC80 <= code <= 0xDCFF:  # a byte that Python could not decode (PEP 383)
        code -= 0xDC00
    if code < 0x100:
        return {0x09: r"\t", 0x0A: r"\n", 0x0D: r"\r"}.get(code, f"\\x{code:02x}")
    return f"\\u{code:04x}" if code < 0x10000 else f"\\U{code:08x}"


def visible(text: str) -> str:
    r"""Replace characters that could break a report or deceive its reader by escapes such as ``\x1b``.

    The result is one line, can be encoded in UTF-8, and holds only characters that XML 1.0 allows.
    """
    return _UNSAFE.sub(_escape, text)


def number(value: float | None) -> str:
    """Three significant digits, as a person writes them: 0.561, 12.3, 1,630, 7.14e-07; ``-`` for None."""
    if value is None:
        return "-"
    if not math.isfinite(value):
        return str(value)
    if abs(value) >= 1e9:
        return f"{value:.2e}"
    if abs(value) >= 999.5:
        return f"{value:,.0f}"
    if value == 0:
        return "0"
    return f"{value:#.3g}".rstrip(".")


def plural(count: int, word: str) -> str:
    """Return ``1 error``, ``1,200 errors``; the word is regular or ends in consonant + y."""
    if count != 1:
        word = f"{word[:-1]}ies" if word.endswith("y") else f"{word}s"
    return f"{count:,} {word}"


def _coordinate(value: float) -> str:
    return f"{round(value, 3) + 0.0:.3f}" if abs(value) < 1e7 else f"{value:.6g}"


def place(spot: Place, *, value: bool = True) -> str:
    """Return a place as ``(12.300, 4.500, -7.800) mm, face 123, value 0.0123``."""
    words = f"({', '.join(map(_coordinate, spot['xyz_mm']))}) mm"
    if spot["face"] is not None:
        words += f", face {spot['face']}"
    if "tissue" in spot:
        words += f" of {visible(spot['tissue'])}"
    if value and "value" in spot:
        words += f", value {number(spot['value'])}"
    return words


def tissue_names(finding: Finding) -> str:
    """Join the tissues of a finding: ``Liver and Stomach``; ``model`` if it concerns no single tissue."""
    return " and ".join(map(visible, finding["tissues"])) or "model"


def headline(finding: Finding) -> str:
    """Return the tissues and the message of a finding in one line."""
    return f"{tissue_names(finding)}: {visible(finding['message'])}"


def file_path(base: str, file: str) -> str:
    """Join the directory of the model and a file of a tissue, without ``./`` in front."""
    path = file if file.startswith("/") else f"{base}{file}"
    while path.startswith("./"):
        path = path[2:].lstrip("/")
    return path
