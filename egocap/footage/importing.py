"""Import of footage: videos or folders of pictures of a rig's cameras in, a sequence out.

Every source is scanned once; the views' clocks and colours are estimated or taken as given; frames
are paired on the first view's clock. Pictures stay where they are, or are copied into shards.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

import egocap
from egocap.cameras.rig import Rig
from egocap.cameras.rig_files import load_rig
from egocap.data.footage import (
    FOOTAGE,
    TIMES,
    Footage,
    FootageImages,
    FootageView,
    FrameTimes,
    load_footage,
)
from egocap.data.manifest import MANIFEST, SCHEMA, Manifest, load_manifest
from egocap.data.resampling import typical_step
from egocap.data.sequence import Sequence as Recording
from egocap.data.sequence import open_sequence
from egocap.data.sequence_writer import SequenceWriter, digest, require_same_config, write_shard
from egocap.errors import FileError, InputError
from egocap.files import make_folder
from egocap.footage.clocks import find_clocks, find_colours
from egocap.footage.config import ImportOptions, Range
from egocap.footage.pairing import ViewFrames, pair, view_frames
from egocap.footage.scan import ViewScan
from egocap.footage.sources import (
    Step,
    fitted_rig,
    open_views,
    scan_name,
    scan_views,
    view_entries,
)
from egocap.locks import holding

SHARD_FRAMES = 50
EDITABLE = ("lag", "drift", "gains", "range")
"""Options that may change for a sequence that refers to its pictures."""
QUALITY = 95  # of JPEG; chroma at full resolution, as subsampling destroys thin coloured limbs


def import_footage(
    sources: Sequence[str | Path],
    rig: Rig | str | Path,
    out: str | Path,
    options: ImportOptions = ImportOptions(),  # noqa: B008 (frozen)
    on_step: Step = lambda name, total: lambda count: None,
) -> Recording:
    """Import footage as a sequence without truth. The same call completes an interrupted one.

    A call with other clocks, colours or another range edits a sequence that refers to its pictures.

    Args:
        sources: a video or a folder of pictures for every view, in the order of the rig; one for
            all with `side_by_side`.
        rig: the cameras, or their file. Scaled to the pictures where their aspect ratio fits.
        out: folder of the sequence.
        options: how the footage is read.
        on_step: called at the beginning of every step.

    Raises:
        FileError: a file is missing, no footage, or of another shape than the rig's.
        InputError: another number of sources than of views, or no common time.
    """
    loaded, out = rig if isinstance(rig, Rig) else load_rig(rig), Path(out)
    views = open_views(sources, loaded, options)
    fitted = fitted_rig(loaded, views)
    entries = view_entries(views, options)
    config = _config(fitted, entries, options)
    prepared = _earlier(out, config)
    if prepared is None:
        make_folder(out)
        scans = scan_views(views, entries, fitted, out, on_step)
        timings = find_clocks(options, scans, entries)
        colours = find_colours(options, scans, timings)
        found = view_frames(scans, timings)
        times = pair(found, options.range, fitted.views)
        report = {view.name: _report(scans[v], found[v], times, v) for v, view in enumerate(views)}
        clocked = [
            e.model_copy(update={"timing": t, "colour": c})
            for e, t, c in zip(entries, timings, colours, strict=True)
        ]
        prepared = Footage(views=tuple(clocked), report=report), times
        with holding(out, folder=True):  # what failed above has changed nothing
            if _earlier(out, config) is None:  # nor has another process ended the same meanwhile
                (out / MANIFEST).unlink(missing_ok=True)
            for old in set(out.glob("scan.*.npz")) - {out / scan_name(e, fitted) for e in entries}:
                old.unlink()
    _write(out, fitted, *prepared, config, options, on_step)
    return open_sequence(out)


def edit_footage(
    out: str | Path,
    options: ImportOptions,
    on_step: Step = lambda name, total: lambda count: None,
) -> Recording:
    """Give an imported sequence other clocks, colours or another range; its scans are used again.

    What `options` leave at the default stays as it was.

    Raises:
        FileError: no imported sequence, or its files are missing.
        InputError: it holds copies of its pictures, whose frames are fixed.
    """
    out = Path(out)
    asked, footage = load_manifest(out).config.get("options"), load_footage(out / FOOTAGE)
    if not isinstance(asked, dict):
        raise FileError(out, "is no import of files", valid="a sequence made from videos")
    plain = ImportOptions()
    if replace(options, **{name: getattr(plain, name) for name in EDITABLE}) != plain:
        raise InputError("an option that an edit does not change",
                         valid="--lag, --drift, --gains, --start, --end, "
                               "--keep-single")  # fmt: skip
    kept = {
        name: _option(asked[name]) for name in EDITABLE
        if getattr(options, name) == getattr(plain, name)
    }  # fmt: skip
    if "range" not in kept:
        given = {k: v for k, v in asdict(options.range).items() if v != getattr(plain.range, k)}
        kept["range"] = replace(_option(asked["range"]), **given)
    views = footage.views
    new = replace(options, **kept, copy=asked["copy"], side_by_side=asked["side_by_side"],
                  pictures=views[0].options)  # fmt: skip
    sources = list(dict.fromkeys(view.path for view in views))
    return import_footage(sources, out / "rig.json", out, new, on_step)


def _option(value: Any) -> Any:
    """An option as read from a manifest."""
    return Range(**value) if isinstance(value, dict) else tuple(value)


def _earlier(out: Path, config: dict[str, Any]) -> tuple[Footage, FrameTimes] | None:
    """What an earlier call found; None if there was none, or with other clocks, colours or range.

    Raises InputError if it differed otherwise.
    """
    if not (out / MANIFEST).exists():
        return None
    there = load_manifest(out)
    before, now = there.config, config
    if not there.shards_hold_images and "options" in before:
        before, now = _fixed(before), _fixed(config)
    require_same_config(out, _Asked(before, digest(before), there.code_version),
                        _Asked(now, digest(now)))  # fmt: skip
    if there.config == config:
        return load_footage(out / FOOTAGE), FrameTimes.load(out / TIMES)
    return None


def _fixed(config: dict[str, Any]) -> dict[str, Any]:
    """The part of a configuration that no edit changes."""
    return config | {"options": {k: v for k, v in config["options"].items() if k not in EDITABLE}}


@dataclass
class _Asked:
    config: dict[str, Any]
    config_sha256: str
    code_version: str = egocap.__version__


def _report(seen: ViewScan, view: ViewFrames, times: FrameTimes, v: int) -> dict[str, float]:
    """What was found in a view's pictures."""
    return {
        "pictures": len(seen.time), "fps": round(1.0 / seen.period, 4), "dropped": seen.dropped,
        "damaged": int((~seen.decoded).sum()), "repeated": int(view.repeated.sum()),
        "black": int(view.black.sum()), "first_s": view.span[0], "last_s": view.span[1],
        "frames_without": int((~times.present[:, v]).sum()),
    }  # fmt: skip


def _config(rig: Rig, entries: list[FootageView], options: ImportOptions) -> dict[str, Any]:
    """Everything that the sequence depends on."""
    sources = [{"name": e.name, "sha256": e.sha256, "part": list(e.part)} for e in entries]
    return json.loads(json.dumps({"sources": sources, "rig": rig.to_dict(),
                                  "options": asdict(options)}))  # fmt: skip


def _write(
    out: Path, rig: Rig, footage: Footage, times: FrameTimes, config: dict[str, Any],
    options: ImportOptions, on_step: Step,
) -> None:  # fmt: skip
    files = {
        "rig.json": (json.dumps(rig.to_dict(), indent=1) + "\n").encode(),
        FOOTAGE: (footage.model_dump_json(indent=1) + "\n").encode(), TIMES: times.content(),
    }  # fmt: skip
    files |= {
        name: (out / name).read_bytes() for name in (scan_name(view, rig) for view in footage.views)
    }
    manifest = Manifest(
        schema_version=SCHEMA, name=out.name, fps=_rate(times), frames=len(times.time),
        shard_frames=SHARD_FRAMES, views=rig.views, seed=0, truth=False,
        shards_hold_images=options.copy, config=config, config_sha256=digest(config),
        code_version=egocap.__version__,
    )  # fmt: skip
    with SequenceWriter(out, manifest, files) as writer:
        writer.begin()
        advance = on_step("copy", len(times.time)) if writer.pending() else None
        pictures = FootageImages(footage, times)
        for shard in writer.pending():
            rows = writer.shard_range(shard)
            assert advance is not None
            frames = (_copied(pictures, rig.views, i, advance) for i in rows)
            writer.add_shard(write_shard(out, shard, rows.start, frames))


def _rate(times: FrameTimes) -> float:
    return round(1.0 / typical_step(times.time), 3)


def _copied(
    pictures: FootageImages, views: tuple[str, ...], index: int, advance: Callable[[int], None]
) -> dict[str, bytes]:
    """Files of one frame; a view without a picture has none."""
    import simplejpeg

    files = {}
    for v, name in enumerate(views):
        image = pictures.image(index, v)
        if image is not None:
            files[f"{name}.jpg"] = simplejpeg.encode_jpeg(
                np.ascontiguousarray(image), QUALITY, colorsubsampling="444"
            )
    files["json"] = json.dumps({"time": float(pictures.times.time[index])}).encode()
    advance(1)
    return files
