"""A mesh in OpenGL's memory, and one draw of its face numbers: runs on the OpenGL thread alone
(gl_context.on_gl_thread).

Vertices, camera and shader program are pyrender's; the framebuffer is ours, as pyrender has none of
whole numbers."""

import ctypes
from pathlib import Path
from typing import Any

import numpy as np
from numpy import ndarray

from arfx.core.scene_mesh import SceneMesh
from arfx.errors import RenderError
from arfx.stages.raster.gl_context import GlContext

_SHADERS = str(Path(__file__).with_name("shaders"))


class Drawing:
    """The faces of a mesh as two primitives: seen from the front alone, and from both sides."""

    def __init__(self, context: GlContext, mesh: SceneMesh) -> None:
        from pyrender.shader_program import ShaderProgramCache

        self.order = np.argsort(~mesh.hidden_behind, kind="stable")
        one_sided = int(mesh.hidden_behind.sum())
        self.primitives = []
        parts = np.split(self.order, [one_sided])
        for first, faces in zip((0, one_sided), parts, strict=True):
            if len(faces):
                primitive = context.pyrender.Primitive(
                    positions=mesh.vertices.astype(np.float32),
                    indices=mesh.faces[faces].astype(np.uint32),
                )
                primitive._add_to_context()
                self.primitives.append((primitive, first, 3 * len(faces)))
        self.one_sided = one_sided
        self.buffer = _Buffer()
        self.programs = ShaderProgramCache(shader_dir=_SHADERS)

    def __call__(
        self, view: ndarray, projection: ndarray, width: int, height: int
    ) -> ndarray:
        """(height * width,) int32, number of the nearest face, -1 = none, bottom row first.

        view, projection : (4, 4);  width, height : texels"""
        from OpenGL import GL

        self.buffer.bind(width, height)
        GL.glEnable(GL.GL_DEPTH_TEST)
        GL.glDepthMask(GL.GL_TRUE)
        GL.glDepthFunc(GL.GL_LESS)
        GL.glDisable(GL.GL_BLEND)
        GL.glPolygonMode(GL.GL_FRONT_AND_BACK, GL.GL_FILL)
        GL.glCullFace(GL.GL_BACK)
        GL.glClear(GL.GL_DEPTH_BUFFER_BIT)
        GL.glClearBufferiv(GL.GL_COLOR, 0, np.full(4, -1, np.int32))
        program = self.programs.get_program("faces.vert", "faces.frag")
        if not program._in_context():
            program._add_to_context()
        program._bind()
        program.set_uniform("V", view)
        program.set_uniform("P", projection)
        for primitive, first, count in self.primitives:
            cull = GL.glEnable if first < self.one_sided else GL.glDisable
            cull(GL.GL_CULL_FACE)
            program.set_uniform("first", first)
            primitive._bind()
            GL.glDrawElements(
                GL.GL_TRIANGLES, count, GL.GL_UNSIGNED_INT, ctypes.c_void_p(0)
            )
            primitive._unbind()
        program._unbind()
        drawn = np.empty(height * width, np.int32)
        GL.glReadBuffer(GL.GL_COLOR_ATTACHMENT0)
        GL.glReadPixels(0, 0, width, height, GL.GL_RED_INTEGER, GL.GL_INT, drawn)
        return np.where(drawn >= 0, self.order.astype(np.int32)[drawn], np.int32(-1))

    def free(self) -> None:
        self.buffer.free()
        self.programs.clear()
        for primitive, _, _ in self.primitives:
            primitive._remove_from_context()


class _Buffer:
    """Framebuffer of whole numbers and float depth; grows, never shrinks."""

    def __init__(self) -> None:
        self.width, self.height = 0, 0
        self.framebuffer: Any = None
        self.stores: list[int] = []

    def bind(self, width: int, height: int) -> None:
        """Raises RenderError where the driver refuses the size."""
        from OpenGL import GL

        if width > self.width or height > self.height:
            self.free()
            self.width = max(self.width, -(-width // 64) * 64)
            self.height = max(self.height, -(-height // 64) * 64)
            self.framebuffer = GL.glGenFramebuffers(1)
            GL.glBindFramebuffer(GL.GL_FRAMEBUFFER, self.framebuffer)
            self.stores = [int(store) for store in GL.glGenRenderbuffers(2)]
            formats = GL.GL_R32I, GL.GL_DEPTH_COMPONENT32F
            targets = GL.GL_COLOR_ATTACHMENT0, GL.GL_DEPTH_ATTACHMENT
            for store, kind, target in zip(
                self.stores, formats, targets, strict=True
            ):
                GL.glBindRenderbuffer(GL.GL_RENDERBUFFER, store)
                GL.glRenderbufferStorage(
                    GL.GL_RENDERBUFFER, kind, self.width, self.height
                )
                GL.glFramebufferRenderbuffer(
                    GL.GL_FRAMEBUFFER, target, GL.GL_RENDERBUFFER, store
                )
            state = GL.glCheckFramebufferStatus(GL.GL_FRAMEBUFFER)
            if state != GL.GL_FRAMEBUFFER_COMPLETE:
                size = f"{self.width}x{self.height}"
                raise RenderError(
                    f"OpenGL refuses a {size} buffer of face numbers (state"
                    f" {int(state):#x})",
                    "the rays back end needs no OpenGL: --set raster.backend=rays",
                )
        GL.glBindFramebuffer(GL.GL_FRAMEBUFFER, self.framebuffer)
        GL.glViewport(0, 0, width, height)

    def free(self) -> None:
        from OpenGL import GL

        if self.framebuffer is not None:
            GL.glDeleteFramebuffers(1, [self.framebuffer])
            GL.glDeleteRenderbuffers(len(self.stores), self.stores)
            self.framebuffer = None
