"""The sources of all views of a rig: opened, compared with the rig, identified, scanned."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from threading import Lock

from egocap.cameras.rig import Rig
from egocap.data.footage import FootageView
from egocap.data.sequence_writer import digest
from egocap.errors import FileError, InputError
from egocap.files import sha256
from egocap.footage.config import ImportOptions
from egocap.footage.scan import ViewScan, picture_meters, scan
from egocap.media.pictures import PictureFolder, PictureOptions
from egocap.media.source import Part, PictureSource, open_source

log = logging.getLogger(__name__)

_ASPECT = 0.01  # relative difference in aspect ratio that rounding explains

Step = Callable[[str, int], Callable[[int], None]]
"""Named step and its number of units in; a function to call with every unit done out."""


@dataclass(frozen=True, eq=False)
class OpenView:
    """One view of the footage during its import."""

    name: str
    source: PictureSource
    part: Part

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the view's pictures."""
        columns = self.part.columns(self.source.size[0])
        return columns.stop - columns.start, self.source.size[1]


def open_views(sources: Sequence[str | Path], rig: Rig, options: ImportOptions) -> list[OpenView]:
    expected = 1 if options.side_by_side else len(rig.views)
    if len(sources) != expected:
        raise InputError(f"{len(sources)} sources for the rig '{rig.name}'",
                         valid=f"{expected}: {', '.join(rig.views)}")  # fmt: skip
    paths = [Path(source).resolve() for source in sources]
    if len(set(paths)) < len(paths):
        raise InputError("the same source twice", valid="--side-by-side, or one source a view")
    opened = [open_source(path, options.pictures) for path in paths]
    folders = [source for source in opened if isinstance(source, PictureFolder)]
    if options.pictures.stamp is None and len({folder.first_number for folder in folders}) > 1:
        log.warning("the pictures begin with %s: taken as of one instant; --lag says otherwise",
                    ", ".join(f"{f.path.name}/{f.files[0].name}" for f in folders))  # fmt: skip
    if options.side_by_side:
        opened *= len(rig.views)
    of = len(rig.views) if options.side_by_side else 1
    return [
        OpenView(name, source, Part(v if options.side_by_side else 0, of))
        for v, (name, source) in enumerate(zip(rig.views, opened, strict=True))
    ]


def fitted_rig(rig: Rig, views: list[OpenView]) -> Rig:
    """The rig at the size of the pictures. Raises FileError where the aspect ratio differs."""
    mounts = []
    for mount, view in zip(rig.mounts, views, strict=True):
        (width, height), camera = view.size, mount.camera
        if abs(width * camera.height / (height * camera.width) - 1.0) > _ASPECT:
            raise FileError(
                view.source.path, f"pictures of {width} x {height} for the view '{mount.name}'",
                valid=f"the aspect ratio of the rig's {camera.width} x {camera.height}",
            )  # fmt: skip
        mounts.append(replace(mount, camera=camera.resized(width, height)))
    return replace(rig, mounts=tuple(mounts))


def view_entries(views: list[OpenView], options: ImportOptions) -> list[FootageView]:
    """What identifies the pictures of every view; a source shared by views is read once."""
    sums: dict[Path, tuple[int, str]] = {}
    for view in views:
        path = view.source.path
        if path not in sums:
            sums[path] = _checksum(path)
    return [
        FootageView(name=view.name, path=str(view.source.path), part=view.part,
                    options=options.pictures, bytes=sums[view.source.path][0],
                    sha256=sums[view.source.path][1])
        for view in views
    ]  # fmt: skip


def _checksum(path: Path) -> tuple[int, str]:
    """Bytes and SHA-256 of a file, or of the names and checksums of a folder's files."""
    if path.is_file():
        return path.stat().st_size, sha256(path)
    files = sorted(p for p in path.iterdir() if p.is_file())
    listed = {p.name: sha256(p) for p in files}
    return sum(p.stat().st_size for p in files), digest(listed)


def scan_views(
    views: list[OpenView], entries: list[FootageView], rig: Rig, out: Path, on_step: Step
) -> list[ViewScan]:
    """Scans from files of an earlier call, or made now, one source a thread."""
    files = [out / scan_name(entry, rig) for entry in entries]
    sources = {id(view.source): view.source for view in views}.values()
    shared = [[v for v, view in enumerate(views) if view.source is source] for source in sources]
    new = [group for group in shared if not all(files[v].exists() for v in group)]
    if new:
        advance = _locked(on_step("scan", sum(len(views[g[0]].source.times) for g in new)))
        meters = picture_meters(rig)

        def measure(group: list[int]) -> None:
            measured = [meters[views[v].name] for v in group]
            parts = tuple(views[v].part for v in group)
            made = scan(views[group[0]].source, parts, measured, advance)
            for v, one in zip(group, made, strict=True):
                one.save(files[v])

        with ThreadPoolExecutor(len(new), thread_name_prefix="scan") as pool:
            list(pool.map(measure, new))
    return [ViewScan.load(file) for file in files]


def _locked(advance: Callable[[int], None]) -> Callable[[int], None]:
    """The function, for calls from several threads."""
    lock = Lock()

    def locked(count: int) -> None:
        with lock:
            advance(count)

    return locked


def scan_name(entry: FootageView, rig: Rig) -> str:
    """File of a view's scan, which depends on its pictures and its camera."""
    of = {"sha256": entry.sha256, "rig": rig.to_dict()}
    if entry.options != PictureOptions():
        of |= {"pictures": asdict(entry.options)}
    return f"scan.{entry.name}.{digest(of)[:12]}.npz"
