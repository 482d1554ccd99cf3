"""A calibration as one JSON-able document, and as extras of the camera file."""

from __future__ import annotations

from typing import Any

import numpy as np

from arfx.calibrate.calibration import Calibration


def document(result: Calibration) -> dict[str, Any]:
    """Everything that was found out.

    Lengths in px unless named otherwise; `camera_matrix` 3x3 nested.
    """
    fitted, known, seen, found = (
        result.fitted,
        result.known,
        result.seen,
        result.found,
    )
    camera, sd = fitted.camera, result.projection_sd_px

    return {
        "verdict": result.verdict.word,
        "reasons": list(result.verdict.reasons),
        "next_picture": result.verdict.next_picture,
        "notices": list(result.notices),
        "board": str(found.spec),
        "image_width": camera.width,
        "image_height": camera.height,
        "camera_matrix": camera.matrix.tolist(),
        "distortion_coefficients": camera.distortion.tolist(),
        "lens_model": fitted.model.name,
        "standard_deviations": dict(
            zip(
                fitted.model.parameters,
                known.standard_deviations.tolist(),
                strict=True,
            )
        ),
        "reprojection_rms_px": fitted.rms_px,
        "held_out_rms_px": result.chosen.held_out_rms_px,
        "corner_noise_px": fitted.noise_px,
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
