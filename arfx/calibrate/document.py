"""A calibration as one JSON-able document, as extras of the camera file, and as lines for
people.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from arfx.calibrate.advice import TILTED_DEG
from arfx.calibrate.calibration import Calibration


def document(result: Calibration) -> dict[str, Any]:
    """Everything that was found out.

    Lengths in px unless named otherwise; `camera_matrix` 3x3 nested.
    """
    fitted, known, seen, found = result.fitted, result.known, result.seen, result.found
    camera, sd = fitted.camera, result.projection_sd_px

    def by_name(values: np.ndarray) -> dict[str, float]:
        return dict(zip(fitted.model.parameters, values.tolist(), strict=True))

    return {
        "verdict": result.verdict.word,
        "reasons": list(result.verdict.reasons),
        "next_picture": result.verdict.next_picture,
        "notices": list(result.notices),
        "board": str(result.spec),
        "image_width": camera.width,
        "image_height": camera.height,
        "camera_matrix": camera.matrix.tolist(),
        "distortion_coefficients": camera.distortion.tolist(),
        "lens_model": fitted.model.name,
        "standard_deviations": by_name(known.standard_deviations),
        "standard_deviation_parts": {
            "independent_corners": by_name(known.independent),
            "between_views_jackknife": by_name(known.jackknife),
        },
        "reprojection_rms_px": fitted.rms_px,
        "held_out_rms_px": result.chosen.held_out_rms_px,
        "corner_noise_px": known.sigma_px,
        "condition": known.condition,
        "projection_sd_px": {
            "median": float(np.median(sd)),
            "p90": float(np.quantile(sd, 0.9)),
            "worst": float(sd.max()),
        },
        "models": [
            {
                "model": e.model.name,
                "held_out_rms_px": e.held_out_rms_px,
                "chosen": e is result.chosen,
                "rejected": e.rejected,
                "fx": e.fitted.camera.fx if e.fitted else None,
                "rms_px": e.fitted.rms_px if e.fitted else None,
            }
            for e in result.evidence
        ],
        "coverage": {
            "cells": seen.cells,
            "counts": seen.counts.tolist(),
            "radius": seen.radius,
            "tilt_max_deg": float(seen.tilt_deg.max()),
            "tilt_span_deg": seen.span_deg,
            "tilt_directions": seen.directions,
        },
        "figures": result.figures,
        "pictures": {
            "searched": found.searched,
            "with_board": len(found.views),
            "used": len(fitted.views),
            "without_board": list(found.empty),
            "other_boards": list(found.instead),
            "copies": [view._asdict() for view in result.copies],
            "rejected": [view._asdict() for view in result.rejected],
            "upside_down": list(result.upside_down),
        },
        "views": [
            {
                "name": v.name,
                "corners": len(v.ids),
                "finder": v.finder,
                "rms_px": float(fitted.view_rms_px[i]),
                "held_out_rms_px": float(result.chosen.held_out_px[i]),
                "tilt_deg": float(seen.tilt_deg[i]),
                "tilt_towards_deg": float(seen.azimuth_deg[i]),
                "sharpness": v.sharpness,
            }
            for i, v in enumerate(fitted.views)
        ],
    }


def file_extras(result: Calibration) -> dict[str, Any]:
    """What the camera file holds besides the camera."""
    d = document(result)
    keys = (
        "verdict",
        "reasons",
        "board",
        "lens_model",
        "standard_deviations",
        "reprojection_rms_px",
        "held_out_rms_px",
    )
    return {k: d[k] for k in keys} | {"views_used": len(result.fitted.views)}


def summary(result: Calibration) -> list[str]:
    """Lines for a terminal."""
    fitted, tilt = result.fitted, result.seen.tilt_deg
    pairs = zip(
        fitted.model.parameters,
        fitted.values,
        result.known.standard_deviations,
        strict=True,
    )
    numbers = [
        f"{n} {v:.2f} ±{s:.2f}" if n[0] in "fc" else f"{n} {v:.4f} ±{s:.4f}"
        for n, v, s in pairs
    ]
    out = [
        f"verdict: {result.verdict.word}",
        *(f"  - {r}" for r in result.verdict.reasons),
        f"intrinsics: {', '.join(numbers[:4])} px",
        f"lens model {fitted.model.name}"
        + (f": {', '.join(numbers[4:])}" if numbers[4:] else ""),
        (
            f"{len(fitted.views)} views: rms {fitted.rms_px:.3f} px, held out"
            f" {result.chosen.held_out_rms_px:.3f} px; tilt {tilt.min():.0f} to"
            f" {tilt.max():.0f}°, {(tilt > TILTED_DEG).sum()} of {len(tilt)} views above"
            f" {TILTED_DEG:.0f}°; {result.seen.cells:.0%} of the picture covered"
        ),
    ]
    out += [f"note: {n}" for n in result.notices]
    return [*out, f"next picture: {result.verdict.next_picture}"]
