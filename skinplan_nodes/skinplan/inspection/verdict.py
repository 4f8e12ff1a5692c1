"""What a report says first: how the run went, in one word and one sentence."""

import math
from dataclasses import dataclass
from typing import Any

from skinplan.inspection.run_files import RunFiles, number, section

# Below this share of the area a part does not count as measured [1].
AREA_RATIO_MIN = 0.95


@dataclass(frozen=True)
class Verdict:
    """How a run went.

    Attributes:
        level: ``good``, ``plain`` (nobody asked for a judgement), ``warn`` or ``bad``.
        title: A few words.
        text: One or two sentences.
    """

    level: str
    title: str
    text: str


def verdict(files: RunFiles) -> Verdict:
    """Judges a run by its summary."""
    if not files.summary:
        return Verdict(
            "bad",
            "No result",
            "The run left no readable summary.json: it was cut off before it could say why.",
        )
    job, measured = section(files.summary, "job"), section(files.summary, "measured")
    state = str(job.get("state") or "")
    error = str(job.get("error") or files.summary.get("error") or "")
    ratio = number(measured.get("area_ratio"))
    if state == "Aborted":
        said = error or "The summary gives no reason."
        kept = (
            f" Up to there {100 * ratio:.1f} % of the area was measured."
            if math.isfinite(ratio)
            else ""
        )
        return Verdict("bad", "Aborted", said + kept)
    if not job:
        return Verdict("warn", "Planned only", "This folder has a plan, but no job was run.")
    if state != "Ended":
        return Verdict(
            "warn",
            f"Not over: {state or 'state unknown'}",
            error or "The job had not ended when this was written.",
        )
    if not math.isfinite(ratio):
        return Verdict(
            "warn", "Ended without a measurement", error or "The summary has no measured area."
        )
    text = _sentence(
        ratio, number(measured.get("feature_area_ratio")), number(measured.get("deviation_rms_m"))
    )
    judged = section(section(files.summary, "inspection"), "verdict")
    if judged.get("state") in ("pass", "fail"):
        return _judged(judged, text)
    if ratio < AREA_RATIO_MIN:
        return Verdict(
            "warn",
            "Measured in part",
            f"{text} At least {100 * AREA_RATIO_MIN:.0f} % are expected.",
        )
    if judged.get("state") == "not_judged":
        return Verdict(
            "plain", "Measured, not judged", f"{text} The part file states no tolerance."
        )
    return Verdict("good", "Measured", text)


def _judged(judged: dict[str, Any], text: str) -> Verdict:
    """How it stands against the tolerances of the part file."""
    if judged["state"] == "pass":
        return Verdict("good", "Within tolerance", text)
    reasons = judged.get("reasons")
    said = " ".join(str(reason) for reason in reasons) if isinstance(reasons, list) else ""
    return Verdict("bad", "Not within tolerance", said or text)


def _sentence(ratio: float, feature_ratio: float, rms_m: float) -> str:
    features = (
        f", {100 * feature_ratio:.1f} % of its complex regions"
        if math.isfinite(feature_ratio)
        else ""
    )
    rms = f" The deviation is {rms_m * 1e3:.3f} mm RMS." if math.isfinite(rms_m) else ""
    return f"{100 * ratio:.1f} % of the part's area was measured{features}.{rms}"
