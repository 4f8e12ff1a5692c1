"""Nine part types on a tray in random layouts: recognition, registration, time (R4.1).

Run as ``python benchmarks/recognition.py run [--layouts N] [--results FILE]``, then ``... table``,
``... plot --picture FILE`` or ``... cloud --picture FILE``. ``run`` appends one JSON line for each
layout and goes on where it was stopped; the database of models is kept beside the results.
"""

import argparse
import json
import resource
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import trimesh

from skinplan.recognition.database import ModelDatabase
from skinplan.recognition.grubbs import grubbs_critical, grubbs_outliers, grubbs_statistic
from skinplan.recognition.tray.layout import PlacedPart, layout
from skinplan.recognition.tray.parts import MAKERS, TWINS, part_mesh
from skinplan.recognition.tray.render import render_database
from skinplan.recognition.tray.scan import coarse_scan, fine_scan, tray_scene
from skinplan.recognition.tray_answers import REGISTRATIONS, TrayPart, TraySettings
from skinplan.recognition.tray_recognizer import TrayRecognizer
from skinplan.transforms import apply, difference

mpl.use("Agg")
from matplotlib import pyplot as plt  # noqa: E402

# What lies as steadily on its back.
TURNABLE = ("doubler", "curved_skin", "rib_left", "rib_right", "hat_stringer", "formed_skin")
MARGIN_M = 0.01


def turned_over(seed: int) -> list[str]:
    """Types that lie upside down in a layout: each that can with a chance of a quarter."""
    rng = np.random.default_rng(10_000 + seed)
    return [name for name in TURNABLE if rng.random() < 0.25]


def part_at(parts: Sequence[PlacedPart], middle: np.ndarray) -> PlacedPart:
    """The part whose box is nearest."""

    def away(part: PlacedPart) -> float:
        points = part.points
        return float(np.linalg.norm(((points.min(0) + points.max(0)) / 2.0 - middle)[:2]))

    return min(parts, key=away)


class Tray:
    """One layout, scanned."""

    def __init__(self, seed: int, recognizer: TrayRecognizer) -> None:
        self.parts = layout(seed, upside_down=turned_over(seed))
        scene, rng = tray_scene(self.parts), np.random.default_rng(seed)
        self.coarse = np.concatenate([view.points for view in coarse_scan(scene, rng)])
        self.contents = recognizer.contents(self.coarse)
        self.views = [
            fine_scan(scene, place.middle, place.radius_m + MARGIN_M, rng)
            for place in self.contents.places
        ]

    def recognized(self, recognizer: TrayRecognizer) -> tuple[list[TrayPart], float, float]:
        """Answers, wall time and processor time [s] of the whole tray, two parts at a time."""
        begin, used = time.perf_counter(), time.process_time()
        contents = recognizer.contents(self.coarse)
        with ThreadPoolExecutor(2) as pool:
            answers = list(
                pool.map(
                    lambda pair: recognizer.part(
                        [view.points for view in pair[1]],
                        [view.seen_from for view in pair[1]],
                        contents.plane,
                        pair[0],
                    ),
                    zip(contents.places, self.views, strict=True),
                )
            )
        return answers, time.perf_counter() - begin, time.process_time() - used


def row(part: PlacedPart, answer: TrayPart) -> dict[str, Any]:
    """What one answer says, beside the truth."""
    found: dict[str, Any] = {
        "truth": part.name,
        "answer": answer.answer,
        "name": answer.name,
        "alike": list(answer.alike),
        "turned": part.upside_down,
        "lies": answer.lies,
        "reason": answer.reason,
    }
    if answer.match is not None:
        nearest = min(answer.match.distances, key=lambda name: answer.match.distances[name])
        others = [d for name, d in answer.match.distances.items() if name != nearest]
        found |= {"vfh": nearest, "vfh_distance": answer.match.distance, "vfh_next": min(others)}
        found["vfh_alike"] = list(answer.match.alike)
    if answer.verdict is not None:
        found |= {"rmse_mm": 1e3 * answer.verdict.rmse_m, "grade": answer.verdict.grade}
    if answer.T_tray_part is not None and answer.name == part.name:
        middle = part.mesh.bounds.mean(axis=0)[None]
        off = apply(answer.T_tray_part, middle) - apply(part.T_tray_part, middle)
        found["off_mm"] = 1e3 * float(np.linalg.norm(off))
        found["turn_deg"] = float(np.rad2deg(difference(part.T_tray_part, answer.T_tray_part)[1]))
    return found


def database_beside(results: Path, models: dict[str, trimesh.Trimesh]) -> ModelDatabase:
    """The database of the models, kept beside the results."""
    path = results.with_suffix(".npz")
    if path.exists():
        database = ModelDatabase.load(path)
        database.check(models)
        return database
    database = render_database(models)
    database.save(path)
    return database


def run(chosen: argparse.Namespace) -> None:
    """Recognises and registers layouts."""
    models = {name: part_mesh(name) for name in MAKERS}
    results: Path = chosen.results[0]
    database = database_beside(results, models)
    recognizers = {
        kind: TrayRecognizer(models, database, TraySettings(registration=kind))
        for kind in chosen.registration
    }
    done = len(results.read_text().splitlines()) if results.exists() else 0
    for seed in range(chosen.first + done, chosen.first + chosen.layouts):
        tray = Tray(seed, next(iter(recognizers.values())))
        line: dict[str, Any] = {"seed": seed, "places": len(tray.contents.places)}
        for kind, recognizer in recognizers.items():
            answers, wall, used = tray.recognized(recognizer)
            truth = [part_at(tray.parts, place.middle) for place in tray.contents.places]
            rows = [row(part, answer) for part, answer in zip(truth, answers, strict=True)]
            line[kind] = {"wall_s": wall, "cpu_s": used, "parts": rows}
        with results.open("a") as stream:
            stream.write(json.dumps(line) + "\n")
        print(seed, {kind: round(line[kind]["cpu_s"], 1) for kind in recognizers}, flush=True)
    print(f"most memory: {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024:.0f} MB")


def parts_of(lines: list[dict[str, Any]], kind: str, name: str) -> list[dict[str, Any]]:
    """Answers about one type."""
    return [
        each
        for line in lines
        if kind in line
        for each in line[kind]["parts"]
        if each["truth"] == name
    ]


def table(lines: list[dict[str, Any]]) -> None:
    """Prints recognition, registration and time; names are those of the first kind that was run."""
    count = len(lines)
    known = [kind for kind in REGISTRATIONS if any(kind in line for line in lines)]
    if not known:
        raise SystemExit(f"a table of layouts was asked; found {count} lines, none with a result")
    print(f"{count} layouts; places found: {sorted({line['places'] for line in lines})}\n")
    print("| part | nearest descriptor | largest distance | least to another | named |")
    print("|---|---|---|---|---|")
    for name in MAKERS:
        rows = parts_of(lines, known[0], name)
        if not rows:
            continue
        own = sum(each.get("vfh") == name for each in rows)
        named = sum(each["name"] == name for each in rows)
        far = max(each["vfh_distance"] for each in rows)
        twin = set(TWINS) - {name} if name in TWINS else set()
        other = "twin" if twin else f"{min(each['vfh_next'] for each in rows):.3f}"
        print(f"| {name} | {own} / {len(rows)} | {far:.3f} | {other} | {named} / {len(rows)} |")
    for kind in known:
        some = [line for line in lines if kind in line]
        registration_table(some, kind)
        for clock in ("wall_s", "cpu_s"):
            values = [line[kind][clock] for line in some]
            print(f"{kind} {clock}: median {np.median(values):.2f}, largest {max(values):.2f}")
    confusion(lines, known[0])


def registration_table(lines: list[dict[str, Any]], kind: str) -> None:
    """Prints eq (3) and (4) as the publication's table 1, and errors against the truth."""
    print(f"\n{kind}: RMSE [mm]\n")
    print("| part | mean | sigma | max | min | G | kept | off [mm] | turned [deg] | good |")
    print("|---|---|---|---|---|---|---|---|---|---|")
    for name in MAKERS:
        rows = [each for each in parts_of(lines, kind, name) if "rmse_mm" in each]
        if not rows:
            continue
        print(f"| {name} {figures([each['rmse_mm'] for each in rows])} {errors(rows)}")
    trays = [
        float(np.mean([e["rmse_mm"] for e in line[kind]["parts"] if "rmse_mm" in e]))
        for line in lines
    ]
    every = [e for line in lines for e in line[kind]["parts"] if "rmse_mm" in e]
    print(f"| whole tray {figures(trays)} {errors(every)}")
    half = 1.96 * np.std(trays, ddof=1) / np.sqrt(len(trays)) if len(trays) > 1 else np.nan
    print(f"\nmean of all trays {np.mean(trays):.4f} mm, 95 % interval of it +- {half:.4f} mm")
    print(f"critical value G_95({len(trays)}) = {grubbs_critical(max(len(trays), 3)):.3f}\n")


def figures(values: list[float]) -> str:
    """Mean, sigma, max, min and G of the values that pass the test of eq (4)."""
    array = np.array(values)
    kept = array[~grubbs_outliers(array)] if len(array) > 2 else array
    sigma = float(np.std(kept, ddof=1)) if len(kept) > 1 else 0.0
    return (
        f"| {kept.mean():.4f} | {sigma:.4f} | {kept.max():.4f} | {kept.min():.4f} | "
        f"{grubbs_statistic(kept):.3f} | {len(kept)} / {len(array)} |"
    )


def errors(rows: list[dict[str, Any]]) -> str:
    """Largest errors against the truth, of all rows, and how many were graded good."""
    known = [each for each in rows if "off_mm" in each]
    good = sum(each["grade"] == "good" for each in rows)
    if not known:
        return f"- | - | {good} / {len(rows)} |"
    off, turn = max(e["off_mm"] for e in known), max(e["turn_deg"] for e in known)
    return f"{off:.4f} | {turn:.4f} | {good} / {len(rows)} |"


def confusion(lines: list[dict[str, Any]], kind: str) -> None:
    """Prints which model each part's descriptor was nearest to, and what was named in the end."""
    for title, key in (("nearest descriptor", "vfh"), ("named", "name")):
        print(f"\n{title}: rows = truth\n\n| | {' | '.join(MAKERS)} | none |")
        print("|---" * (len(MAKERS) + 2) + "|")
        for name in MAKERS:
            said = [each.get(key) for each in parts_of(lines, kind, name)]
            counts = [said.count(other) for other in MAKERS] + [said.count(None)]
            print(f"| {name} | {' | '.join(map(str, counts))} |")


def plot(lines: list[dict[str, Any]], picture: Path) -> None:
    """Draws the RMSE of each part type over the layouts."""
    figure, axes = plt.subplots(1, 2, figsize=(12, 4.5), layout="constrained")
    for axis, kind in zip(axes, ("global", "pso"), strict=True):
        values = [
            [each["rmse_mm"] for each in parts_of(lines, kind, name) if "rmse_mm" in each]
            for name in MAKERS
        ]
        axis.boxplot(values, orientation="horizontal", tick_labels=list(MAKERS), whis=(0, 100))
        limit = 0.2 if kind == "global" else 1.403
        axis.axvline(limit, color="tab:red", linestyle="--")
        axis.set_xlabel("RMSE, eq (3) [mm]")
        some = sum(kind in line for line in lines)
        axis.set_title(f"{kind}, {some} layouts; dashed: {limit} mm")
        axis.invert_yaxis()
    figure.savefig(picture, dpi=90)


def cloud(seed: int, results: Path, picture: Path) -> None:
    """Draws the registered models over the cloud of one tray."""
    models = {name: part_mesh(name) for name in MAKERS}
    recognizer = TrayRecognizer(models, database_beside(results, models))
    tray = Tray(seed, recognizer)
    answers, _, _ = tray.recognized(recognizer)
    figure, axis = plt.subplots(figsize=(13, 6.8), layout="constrained")
    axis.plot(*tray.coarse[::3, :2].T, ",", color="0.75")
    for answer, views in zip(answers, tray.views, strict=True):
        points = np.concatenate([view.points for view in views])
        points = points[tray.contents.plane.heights(points) > 0.0006][::7]
        axis.plot(*points[:, :2].T, ",", color="tab:purple")
        if answer.T_tray_part is None or answer.name is None:
            continue
        mesh = models[answer.name]
        corners = apply(answer.T_tray_part, np.asarray(mesh.vertices))
        edges = mesh.face_adjacency_edges[mesh.face_adjacency_angles > 0.5]
        for start, end in corners[edges][:, :, :2]:
            axis.plot([start[0], end[0]], [start[1], end[1]], color="tab:orange", linewidth=0.8)
        assert answer.verdict is not None
        label = f"{answer.name}\n{answer.lies}, RMSE {1e3 * answer.verdict.rmse_m:.2f} mm"
        top = float(corners[:, 1].max())
        place, anchor = (top + 0.01, "bottom") if top < 0.82 else (corners[:, 1].min(), "top")
        axis.text(float(corners[:, 0].mean()), place, label, fontsize=8, ha="center", va=anchor)
    axis.set_aspect("equal")
    axis.set(xlabel="x [m]", ylabel="y [m]", xlim=(0, 1.8), ylim=(0, 0.9))
    axis.set_title("Points over the tray (purple), registered models (orange)")
    figure.savefig(picture, dpi=90)


def main() -> None:
    """Reads what to do."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("task", choices=("run", "table", "plot", "cloud"))
    parser.add_argument("--first", type=int, default=0, help="seed of the first layout")
    parser.add_argument("--layouts", type=int, default=100)
    parser.add_argument("--results", type=Path, nargs="+", default=[Path("recognition.jsonl")])
    parser.add_argument("--registration", nargs="+", default=REGISTRATIONS, choices=REGISTRATIONS)
    parser.add_argument("--picture", type=Path, default=Path("recognition.png"))
    parser.add_argument("--seed", type=int, default=0)
    chosen = parser.parse_args()
    if chosen.task == "run":
        run(chosen)
    elif chosen.task == "cloud":
        cloud(chosen.seed, chosen.results[0], chosen.picture)
    else:
        texts = [path.read_text() for path in chosen.results]
        lines = [json.loads(line) for text in texts for line in text.splitlines()]
        table(lines) if chosen.task == "table" else plot(lines, chosen.picture)


if __name__ == "__main__":
    main()
