"""The stated hard cases, each with the tests that hold it.

The tests say what is right; this says where to look.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Case:
    """asked : what was asked of arfx;  tests : pytest node ids, without parameters"""

    name: str
    asked: str
    tests: tuple[str, ...]


_PROCESS, _MEDIA = "tests/cli/test_process.py", "tests/contract/test_media.py"
_FIT, _PHOTO = (
    "tests/unit/analyse/light/test_fit.py",
    "tests/unit/analyse/light/test_photometry.py",
)
_GI, _DOF, _PAINT = (
    "tests/unit/stages/test_gi.py",
    "tests/unit/stages/test_dof.py",
    "tests/unit/stages/test_watercolor_stage.py",
)
_POSE = "tests/property/test_planar_poses.py"

CASES: tuple[Case, ...] = (
    Case("no marker at all", "exit 4, what was tried and what is there",
         (f"{_PROCESS}::test_no_marker_at_all_exits_4_and_says_what_was_tried",)),
    Case("a marker that is never seen", "said, the job goes on", (f"{_PROCESS}::test_a_marker_that_is_never_seen_is_said",)),
    Case("bad input", "one clear message each", (f"{_PROCESS}::test_bad_input_gets_one_clear_message",)),
    Case("a killed job", "resumes, same bytes", (f"{_PROCESS}::test_a_killed_job_resumes_and_gives_the_same_bytes",)),
    Case("a full disk, a read-only place", "one message, nothing half-written",
         (f"{_PROCESS}::test_read_only_output_and_full_disk_are_one_message",
          f"{_PROCESS}::test_a_full_disk_leaves_nothing_half_written")),
    Case("a camera of another size", "scaled and said", (f"{_PROCESS}::test_a_camera_of_another_size_is_scaled_with_a_notice",)),
    Case("a truncated file", "its good frames, and said",
         (f"{_MEDIA}::test_a_truncated_file_gives_its_good_frames_and_says_so",)),
    Case("odd sizes, one frame, HDR", "4:4:4, worked, as it came",
         (f"{_MEDIA}::test_odd_sizes_become_444_with_a_notice", f"{_MEDIA}::test_one_frame", "tests/cli/test_hdr.py::test_an_hdr_clip_comes_out_as_it_came")),
    Case("nearly frontal markers", "finite poses", (f"{_POSE}::test_nearly_frontal_views_give_finite_poses",
                                                   f"{_POSE}::test_corners_that_no_direction_leads_to_give_no_pose")),
    Case("one normal only", "no direction claimed", (f"{_FIT}::test_too_few_normals_are_refused_in_words",)),
    Case("a lamp at the horizon or behind", "right or refused",
         (f"{_FIT}::test_a_lamp_at_the_horizon_or_behind_is_never_claimed_wrongly",)),
    Case("even light, black light", "refused", (f"{_FIT}::test_even_and_black_light_are_refused",)),
    Case("two equal lamps", "never their middle", (f"{_FIT}::test_two_equal_lamps_are_never_their_middle",)),
    Case("degenerate photometry", "reported, finite",
         (f"{_PHOTO}::test_degenerate_systems_are_reported_and_nothing_non_finite_leaves",
          f"{_PHOTO}::test_albedos_that_hardly_differ_are_degenerate_beside_noise")),
    Case("not finite samples", "left out and counted", (f"{_PHOTO}::test_a_nan_in_a_patch_costs_that_patch_alone",)),
    Case("hard layers for every stage", "finite", ("tests/contract/test_stages.py::test_finite_on_hard_layers",)),
    Case("camera inside the object", "finite", (f"{_GI}::test_camera_inside_and_an_object_that_fills_the_picture",)),
    Case("no light at all", "black, finite", (f"{_GI}::test_no_light_at_all", f"{_DOF}::test_a_black_frame_stays_black")),
    Case("object touching, hovering, sunk", "no jump", (f"{_GI}::test_touching_hovering_and_sunk",
                                                       f"{_GI}::test_a_millimetre_makes_no_jump")),
    Case("white furnace", "1 at every resolution", (f"{_GI}::test_white_furnace",)),
    Case("focus within the focal length", "an input error", (f"{_DOF}::test_a_focus_within_the_focal_length_is_an_input_error",)),
    Case("depths that are none", "sharp, finite", (f"{_DOF}::test_depths_that_are_none",)),
    Case("a blur larger than the picture", "finite", (f"{_DOF}::test_a_bounded_blur_and_odd_sizes",)),
    Case("flat frames, any size, bad depth to paint", "flat stays flat, finite",
         (f"{_PAINT}::test_flat_frames_stay_flat", f"{_PAINT}::test_any_size_is_painted",
          f"{_PAINT}::test_depth_that_is_not_a_number_harms_nothing")),
    Case("degenerate models", "refused or counted", ("tests/unit/media/test_models.py::test_refusals",
                                                    "tests/unit/media/test_models.py::test_faces_without_area_are_dropped_and_counted")),
)  # fmt: skip
