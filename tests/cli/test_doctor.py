"""`arfx doctor`: one document, or lines for people, and what a machine without OpenGL gets."""

from __future__ import annotations

from tests.cli.conftest import Run


def test_one_json_document(arfx: Run) -> None:
    r = arfx("doctor", "--json")
    assert r.code == 0, r.err
    document = r.json
    assert document["ok"] is True
    by_name = {c["name"]: c for c in document["checks"]}
    assert by_name["auto"]["ok"] and by_name["auto"]["detail"].startswith(
        ("takes pyrender: ", "takes rays: ")
    )
    assert (
        by_name["rays"]["ok"]
        and by_name["h264"]["ok"]
        and by_name["h264"]["essential"]
    )
    assert {"group", "name", "ok", "detail", "fix", "essential"} == set(
        by_name["python"]
    )


def test_without_opengl_it_says_so_with_the_fix_and_still_works(arfx: Run) -> None:
    no_vendor = {
        "__EGL_VENDOR_LIBRARY_DIRS": "/nowhere",
        "__EGL_VENDOR_LIBRARY_FILENAMES": "",
    }
    r = arfx("doctor", "--json", env=no_vendor)
    assert r.code == 0, r.err
    renderers = {c["name"]: c for c in r.json["checks"] if c["group"] == "renderer"}
    assert renderers["rays"]["ok"]
    gl = renderers["pyrender"]
    assert ("osmesa" in gl["detail"]) if gl["ok"] else ("apt-get" in gl["fix"]), gl
    r = arfx("doctor", env=no_vendor)
    assert (
        r.code == 0
        and "Clips can be processed here." in r.out
        and "Traceback" not in r.err
    )
    assert gl["ok"] or "Missing, not essential: pyrender" in r.out
