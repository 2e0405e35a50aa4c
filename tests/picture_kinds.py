"""Kinds of pictures by the first bytes of their files, whatever their names."""

from __future__ import annotations

from pathlib import Path


def find_kind(path: Path) -> str:
    """Return png, pdf or svg (PNG specification 5.2, ISO 32000 7.5.2, XML with the element <svg>); else nothing."""
    start = path.read_bytes()[:2000]
    if start.startswith(b"\x89PNG\r\n\x1a\n"):
        return "png"
    if start.startswith(b"%PDF-"):
        return "pdf"
    return "svg" if start.startswith(b"<?xml") and b"<svg" in start else ""
