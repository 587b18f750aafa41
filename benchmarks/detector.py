"""Stereo pairs a second of the learned detector, by engine, and how far engines are from torch.

    python benchmarks/detector.py                       # 640 x 512, all engines that are there
    python benchmarks/detector.py --size 1280 1024 --threads 2 --engines onnxruntime openvino
    python benchmarks/detector.py --json

Pictures are noise over a gradient, as JPEGs of quality 95 on disk in memory: decoding, the
canonical view, the network and its maps are measured one by one (wall time of each alone) and
together, as `egocap detect` runs them: pictures are prepared by a thread while the network works on
as many others as it has streams, which share the threads. With one stream a run has all threads.
Other work on the machine disturbs the figures.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

import numpy as np  # noqa: E402

from egocap.cameras.rig_files import load_rig  # noqa: E402
from egocap.detect.detector import Detector  # noqa: E402
from egocap.detect.engine import Engine, available_cores, open_engine  # noqa: E402
from egocap.detect.input_images import ahead  # noqa: E402
from egocap.detect.weights import Weights, open_weights  # noqa: E402
from egocap.errors import EgocapError  # noqa: E402

SPINNING = "onnxruntime-spin"  # its threads wait busily within a call
ENGINES = (
    "onnxruntime", SPINNING, "onnxruntime-int8", "openvino", "openvino-int8", "torch", "cuda",
)  # fmt: skip
TIMES = np.zeros(1)


def engine_named(weights: Weights, name: str, threads: int) -> Engine:
    """The engine of one of `ENGINES`, with one stream."""
    spin = name == SPINNING
    return open_engine(weights, "onnxruntime" if spin else name, threads, spin)  # type: ignore[arg-type]


def jpegs(size: tuple[int, int], count: int = 8) -> list[bytes]:
    """Pictures about as heavy as a rendered room: 60 to 130 kB at 640 x 512."""
    import cv2

    rng = np.random.default_rng(0)
    width, height = size
    made = []
    for _ in range(count):
        coarse = rng.integers(0, 256, (height // 16, width // 16, 3), dtype=np.uint8)
        picture = cv2.resize(coarse, size, interpolation=cv2.INTER_CUBIC).astype(np.int16)
        picture += rng.normal(0, 4, picture.shape).astype(np.int16)
        options = [cv2.IMWRITE_JPEG_QUALITY, 95]
        made.append(cv2.imencode(".jpg", np.clip(picture, 0, 255).astype(np.uint8), options)[1])
    return [m.tobytes() for m in made]


def measure(
    weights: Weights, engine: str, threads: int, streams: int | None, size: tuple[int, int],
    pairs: int, batch: int,
) -> dict[str, Any]:  # fmt: skip
    """Milliseconds a pair of every stage alone, the rate of all together, and its streams.

    The spinning engine has one stream, whatever `streams` says: while its threads wait, they use
    the cores that another stream needs.
    """
    import cv2

    rig = load_rig(ROOT / "scenes/rigs/egorig1.toml").resized(*size)
    opened = engine_named(weights, engine, threads) if engine == SPINNING else engine
    detector = Detector(rig, weights, opened, threads, streams)  # type: ignore[arg-type]
    files = jpegs(size)
    flags = cv2.IMREAD_COLOR_RGB | (cv2.IMREAD_REDUCED_GRAYSCALE_2 if size[0] >= 1280 else 0)

    def decoded(pair: int) -> list[Any]:
        chosen = (files[(2 * pair + v) % len(files)] for v in range(2))
        return [cv2.imdecode(np.frombuffer(data, np.uint8), flags) for data in chosen]

    def prepared(start: int) -> Any:
        return detector.canonical([decoded(start + i) for i in range(batch)])

    pictures = [decoded(i) for i in range(batch)]
    views, slots = detector.canonical(pictures)
    outputs = detector.run(views)
    stages = {
        "decode JPEG": lambda: decoded(0),
        "canonical view": lambda: detector.canonical(pictures[:1]),
        "network": lambda: detector.run(views),
        "decode maps": lambda: detector.read(outputs, slots, np.zeros(batch)),
    }
    shared = {"network": batch, "decode maps": batch}
    spent = {name: _ms(stage, 30) / shared.get(name, 1) for name, stage in stages.items()}

    def found(job: Any) -> Any:
        views, slots = job
        return detector.read(detector.run(views), slots, np.zeros(batch))

    start, n = time.perf_counter(), detector.engine.streams
    for _ in ahead(ahead(iter(range(0, pairs, batch)), prepared, 2 * n), found, n, n):
        pass
    rate = pairs / (time.perf_counter() - start)
    return {"stages_ms": {k: round(v, 2) for k, v in spent.items()},
            "pairs_per_second": round(rate, 1), "streams": n}  # fmt: skip


def deviation(weights: Weights, engine: str, threads: int) -> dict[str, float]:
    """Largest difference from torch on the CPU: of the maps' probabilities, and of log sigma."""
    from egocap.detect.heatmaps import probabilities

    shape = (2, weights.view.height, weights.view.width, 3)
    images = np.random.default_rng(1).integers(0, 256, shape, dtype=np.uint8)
    heat, info = engine_named(weights, engine, threads).run(images)
    expected = open_engine(weights, "torch", threads).run(images)
    off = np.abs(probabilities(heat) - probabilities(expected[0])).max()
    return {"probability": float(off), "log_sigma": float(np.abs(info - expected[1])[..., 3].max())}


def _ms(stage: Callable[[], Any], count: int) -> float:
    stage()
    start = time.perf_counter()
    for _ in range(count):
        stage()
    return 1e3 * (time.perf_counter() - start) / count


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--engines", nargs="+", choices=ENGINES, default=list(ENGINES))
    parser.add_argument(
        "--weights", type=Path, help="detector weights; the shipped ones by default"
    )
    parser.add_argument("--threads", type=int, default=available_cores())
    parser.add_argument("--streams", type=int, help="one a thread by default, 8 at most")
    parser.add_argument("--size", type=int, nargs=2, default=(640, 512), metavar=("W", "H"))
    parser.add_argument("--pairs", type=int, default=300)
    parser.add_argument("--batch", type=int, default=1, help="pairs through the network at once")
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--out", type=Path, help="also write a result, .json, with its machine")
    options = parser.parse_args()
    report: dict[str, Any] = {"threads": options.threads, "size": list(options.size),
                              "batch": options.batch, "engines": {}}  # fmt: skip
    weights = open_weights(options.weights)
    report["weights"] = weights.name
    for engine in options.engines:
        try:
            found = measure(weights, engine, options.threads, options.streams,
                            tuple(options.size), options.pairs, options.batch)  # fmt: skip
            found["off_torch"] = deviation(weights, engine, options.threads)
        except EgocapError as error:
            found = {"missing": str(error)}
        report["engines"][engine] = found
        if not options.json:
            _show(engine, found)
    if options.json:
        print(json.dumps(report, indent=1))
    if options.out:
        from egocap_eval.harness.result_file import save_result

        save_result(options.out, report, ["python", *sys.argv])


def _show(engine: str, found: dict[str, Any]) -> None:
    if "missing" in found:
        print(f"{engine:16} {found['missing']}")
        return
    stages = ", ".join(f"{name} {ms:.1f}" for name, ms in found["stages_ms"].items())
    off = found["off_torch"]
    print(f"{engine:16} {found['pairs_per_second']:6.1f} pairs/s; ms a pair alone: {stages}; "
          f"off torch by {off['probability']:.4f} (probability)")  # fmt: skip


if __name__ == "__main__":
    main()
