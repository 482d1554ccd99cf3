"""The one thread that does a process's OpenGL work: who may call it, and what comes back."""

from __future__ import annotations

import gc
import signal
import threading
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from arfx.core.scene import Scene
from arfx.errors import RenderError
from arfx.stages.raster import gl_context
from arfx.stages.raster.gl_context import discard, on_gl_thread
from arfx.stages.raster.renderer import Renderer
from tests.scenes import box_model
from tests.unit.stages.raster_scenes import camera, in_front

pytestmark = pytest.mark.process


def opengl_renderer(scene: Scene) -> Renderer:
    from arfx.stages.raster.gl import GlFaces

    return Renderer(scene.mesh, scene.camera, GlFaces, 4)


def test_all_work_is_done_by_one_thread_that_is_not_the_callers() -> None:
    with ThreadPoolExecutor(3) as pool:
        seen = list(pool.map(lambda _: on_gl_thread(threading.get_ident), range(12)))
    assert (
        len({*seen, on_gl_thread(threading.get_ident)}) == 1
        and seen[0] != threading.get_ident()
    )


def test_what_the_work_raises_reaches_the_caller_and_the_thread_goes_on() -> None:
    def fail(what: str) -> None:
        raise RenderError(what, "a hint")

    with pytest.raises(RenderError, match="the driver refuses") as e:
        on_gl_thread(fail, "the driver refuses")
    assert e.value.hint == "a hint" and on_gl_thread(lambda: 3) == 3


def test_ctrl_c_does_not_wait_for_the_work(ctrl_c: None) -> None:
    caught, threads = threading.Event(), []

    def work() -> bool:
        threads.append(threading.get_ident())
        for _ in range(
            40
            # a signal that comes just before the main thread starts to wait is seen at the next
            # one only
        ):
            signal.pthread_kill(threading.main_thread().ident, signal.SIGINT)
            if caught.wait(0.5):
                return True
        return False

    with pytest.raises(KeyboardInterrupt):
        on_gl_thread(work)
    caught.set()
    assert on_gl_thread(threading.get_ident) == threads[0], (
        "an interrupt left two threads"
    )


def test_what_is_discarded_anywhere_is_freed_by_the_thread() -> None:
    freed: list[int] = []
    discard(lambda: freed.append(threading.get_ident()))
    assert not freed
    assert on_gl_thread(threading.get_ident) == freed[0]


def test_a_forked_process_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gl_context, "_pid", -1)
    with pytest.raises(RenderError, match="forked"):
        on_gl_thread(lambda: 3)


@pytest.mark.opengl
def test_a_renderer_serves_any_thread() -> None:
    scene = Scene(camera(), box_model(0.3), np.eye(4))
    with ThreadPoolExecutor(
        1
    ) as pool:  # as a job's warm-up does: made and dropped in a thread that ends
        pool.submit(
            lambda: opengl_renderer(scene).render(scene.camera.rect, in_front())
        ).result()
    renderer = opengl_renderer(scene)
    poses = [in_front(1.0 + 0.1 * k, 30, 10 * k) for k in range(8)]
    alone = [renderer.render(scene.camera.rect, pose) for pose in poses]
    with ThreadPoolExecutor(3) as pool:
        together = list(
            pool.map(lambda pose: renderer.render(scene.camera.rect, pose), poses)
        )
    for a, b in zip(alone, together, strict=True):
        assert all(np.array_equal(a[name], b[name]) for name in a)


@pytest.mark.opengl
def test_a_renderer_that_is_gone_leaves_nothing_in_the_driver() -> None:
    scene = Scene(camera(), box_model(0.3), np.eye(4))
    renderer = opengl_renderer(scene)
    renderer.render(scene.camera.rect, in_front())
    drawing = renderer.faces.drawing
    assert drawing.buffer.framebuffer is not None
    del renderer
    gc.collect()
    on_gl_thread(lambda: None)
    assert drawing.buffer.framebuffer is None
    assert not drawing.primitive._in_context()


@pytest.mark.opengl
def test_what_the_driver_says_is_one_message() -> None:
    scene = Scene(camera(), box_model(0.3), np.eye(4))
    renderer = opengl_renderer(scene)

    def refused() -> None:
        from OpenGL import GL

        GL.glBindFramebuffer(GL.GL_FRAMEBUFFER, 12345)  # never made

    renderer.faces.drawing.buffer.bind = lambda *_: refused()  # type: ignore[method-assign]
    with pytest.raises(
        RenderError, match=r"OpenGL failed: GLError.*1282.*glBindFramebuffer"
    ) as e:
        renderer.render(scene.camera.rect, in_front())
    assert "raster.backend=rays" in e.value.hint
