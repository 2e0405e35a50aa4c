"""Files of a film: a page for a browser, a GIF or a PNG by Pillow, an MP4 by ffmpeg.

The same film gives the same bytes; of an MP4, with the same ffmpeg.
"""

from __future__ import annotations

import shutil
import subprocess
import tempfile
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image

from mbsgen.errors import Fault, InputError
from mbsrun.animation.film import Film
from mbsrun.animation.page import write_page
from mbsrun.animation.raster import Picture, draw_film

Report = Callable[[str, int, int], None]  # takes the current step, the number of finished pictures and of all

COLORS = 255  # of a GIF's palette
SAMPLED = 9  # pictures of which the palette is made


STRIP = 6  # pictures of a strip
SEAM = 4  # pixels between them


@dataclass(frozen=True)
class Size:
    """The size of pictures, and the times of pictures in a strip."""

    width: int = 640
    height: int = 480
    at: tuple[float, ...] = ()  # [s]; without any, STRIP of them over the whole time


def write_html(film: Film, path: Path, size: Size, report: Report) -> None:  # noqa: ARG001  # a writer of WRITERS
    """Write the page that plays a film."""
    path.write_text(write_page(film), encoding="utf-8")


def write_gif(film: Film, path: Path, size: Size, report: Report) -> None:
    """Write a GIF that repeats; its times are rounded to hundredths of a second."""
    pictures = [Image.fromarray(x) for x in _draw(film, size, report)]
    chosen = [pictures[i] for i in np.unique(np.linspace(0, len(pictures) - 1, SAMPLED).round().astype(int))]
    sheet = Image.new("RGB", (size.width, size.height * len(chosen)))
    for i, picture in enumerate(chosen):
        sheet.paste(picture, (0, i * size.height))
    palette = sheet.quantize(COLORS, method=Image.Quantize.MAXCOVERAGE, kmeans=1, dither=Image.Dither.NONE)
    frames = [x.quantize(palette=palette, dither=Image.Dither.NONE) for x in pictures]
    ends = np.rint(100 * (film.times - film.times[0]))
    lasting = np.diff(ends, append=ends[-1] + 100).clip(2) * 10
    frames[0].save(path, save_all=True, append_images=frames[1:], duration=lasting.tolist(), loop=0, optimize=False)


def write_png(film: Film, path: Path, size: Size, report: Report) -> None:
    """Write a strip of pictures, row by row."""
    first, last = film.times[0], film.times[-1]
    wanted = size.at or tuple(np.linspace(first, last, STRIP if last > first else 1))
    chosen = [int(np.abs(film.times - t).argmin()) for t in wanted]
    columns = {1: 1, 2: 2, 4: 2}.get(len(chosen), 3)
    rows = -(-len(chosen) // columns)
    shape = (columns * (size.width + SEAM) - SEAM, rows * (size.height + SEAM) - SEAM)
    sheet = Image.new("RGB", shape, "white")
    for i, picture in enumerate(draw_film(film, size.width, size.height, chosen)):
        report("drawing", i + 1, len(chosen))
        place = (i % columns * (size.width + SEAM), i // columns * (size.height + SEAM))
        sheet.paste(Image.fromarray(picture), place)
    sheet.save(path, format="PNG", optimize=True)


def write_mp4(film: Film, path: Path, size: Size, report: Report) -> None:
    """Write an MP4 in H.264, which any player shows. Raises InputError without ffmpeg, or with its words."""
    program = shutil.which("ffmpeg")
    if program is None:
        remedy = "install ffmpeg, or write a .gif or .html"
        raise InputError([Fault(str(path), 0, "", "ffmpeg, which writes MP4, is not on the path", remedy)])
    span = float(film.times[-1] - film.times[0])
    rate = (len(film.times) - 1) / span if span > 0 else 1.0
    shape = f"{size.width}x{size.height}"
    command = [program, "-y", "-v", "error", "-f", "rawvideo", "-pix_fmt", "rgb24", "-s", shape, "-r", f"{rate:.6f}"]
    command += ["-i", "-", "-an", "-vf", "pad=ceil(iw/2)*2:ceil(ih/2)*2", "-c:v", "libx264", "-crf", "18"]
    command += ["-pix_fmt", "yuv420p", "-movflags", "+faststart", "-fflags", "+bitexact", "-flags:v", "+bitexact"]
    with tempfile.TemporaryFile() as words:
        process = subprocess.Popen([*command, str(path.absolute())], stdin=subprocess.PIPE, stderr=words)
        assert process.stdin is not None
        try:
            for picture in _draw(film, size, report):
                process.stdin.write(picture.tobytes())
            process.stdin.close()
        except BrokenPipeError:  # it ended early, and says why
            pass
        finally:
            failed = process.wait() != 0
        if failed:
            words.seek(0)
            told = words.read().decode(errors="replace").strip().splitlines() or ["no reason given"]
            raise InputError([Fault(str(path), 0, "", f"ffmpeg failed: {told[-1][:200]}", "write a .gif instead")])


def _draw(film: Film, size: Size, report: Report) -> Iterator[Picture]:
    for i, picture in enumerate(draw_film(film, size.width, size.height), 1):
        report("drawing", i, len(film.times))
        yield picture


WRITERS: Mapping[str, Callable[[Film, Path, Size, Report], None]] = {
    ".html": write_html,
    ".gif": write_gif,
    ".png": write_png,
    ".mp4": write_mp4,
}


def write_film(film: Film, path: Path, size: Size, report: Report) -> None:
    """Write a film to a file of one of WRITERS, by its suffix. Raises InputError for another suffix."""
    writer = WRITERS.get(path.suffix.lower())
    if writer is None:
        finding = f"found {path.suffix or 'nothing'} at the end of its name"
        raise InputError([Fault(str(path), 0, "", finding, f"give a file that ends in {', '.join(WRITERS)}")])
    writer(film, path, size, report)
