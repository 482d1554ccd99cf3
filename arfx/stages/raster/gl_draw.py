"""What a renderer keeps in OpenGL, and one draw of it: runs on the OpenGL thread alone (gl_context.on_gl_thread).

Meshes, textures and shader programs are pyrender's; the framebuffer is ours, as pyrender has none of floats."""

from __future__ import annotations

import ctypes
from pathlib import Path
from typing import Any

import numpy as np

from arfx.errors import RenderError
from arfx.stages.raster import mesh as columns
from arfx.stages.raster.gl_context import GlContext
from arfx.stages.raster.mesh import Mesh
from arfx.stages.raster.textures import WRAP_COLUMN

_GL_WRAPS = (10497, 33071, 33648)  # of textures.WRAPS: repeat, clamp to edge, mirrored repeat
_SHADERS = str(Path(__file__).with_name("shaders"))  # of the geometry buffer


class Drawing:
    """A mesh in OpenGL's memory. Calling it draws the mesh once and reads it back: see _Buffer.read."""

    def __init__(self, context: GlContext, mesh: Mesh, glows: bool) -> None:
        from pyrender.shader_program import ShaderProgramCache

        self.glows = glows
        self.textures: dict[int, Any] = {}
        for t, row in enumerate(mesh.textures.table):
            w, h, start = int(row[0]), int(row[1]), int(row[3])
            picture = mesh.textures.texels[start : start + w * h].reshape(h, w, 4)
            wrap = (_GL_WRAPS[way] for way in row[WRAP_COLUMN : WRAP_COLUMN + 2])
            sampler = context.pyrender.Sampler(None, None, None, *wrap)
            self.textures[t] = context.pyrender.Texture(
                sampler=sampler, source=picture, source_channels="RGBA"
            )
            self.textures[t]._add_to_context()
        self.parts = [
            _Part(context.pyrender, mesh, part, self.textures) for part in range(len(mesh.ints))
        ]
        self.buffer = _Buffer(4 if glows else 3)
        self.programs = ShaderProgramCache(shader_dir=_SHADERS)

    def __call__(
        self,
        view: np.ndarray,
        projection: np.ndarray,
        width: int,
        height: int,
        peel: np.ndarray | None,
    ) -> list[np.ndarray]:
        """peel : (height * width,) depth at and before which nothing is drawn, None = draw all"""
        from OpenGL import GL

        self.buffer.bind(width, height)
        GL.glEnable(GL.GL_DEPTH_TEST)
        GL.glDepthMask(GL.GL_TRUE)
        GL.glDepthFunc(GL.GL_LESS)
        GL.glDisable(GL.GL_BLEND)
        GL.glPolygonMode(GL.GL_FRONT_AND_BACK, GL.GL_FILL)
        GL.glClearColor(0, 0, 0, 0)
        GL.glClear(GL.GL_COLOR_BUFFER_BIT | GL.GL_DEPTH_BUFFER_BIT)
        if peel is not None:
            self.buffer.bind_peel(peel, width, height)
        eye = np.linalg.inv(view)[:3, 3]
        for part in self.parts:
            part(self.programs, view, projection, eye, peel is not None, self.glows)
        return self.buffer.read(width, height)

    def free(self) -> None:
        self.buffer.free()
        self.programs.clear()
        for texture in self.textures.values():
            texture._remove_from_context()
        for part in self.parts:
            part.primitive._remove_from_context()


class _Buffer:
    """Framebuffer of 3 or 4 colour targets and float depth; grows, never shrinks."""

    def __init__(self, targets: int) -> None:
        self.targets, self.width, self.height = targets, 0, 0
        self.framebuffer: Any = None
        self.stores: list[int] = []
        self.peel: Any = None

    def bind(self, width: int, height: int) -> None:
        from OpenGL import GL

        if width > self.width or height > self.height:
            self.free()
            self.width, self.height = (
                max(self.width, -(-width // 64) * 64),
                max(self.height, -(-height // 64) * 64),
            )
            formats = [GL.GL_RGBA32F, GL.GL_RGBA16, GL.GL_RGBA16, GL.GL_RGBA16F][: self.targets]
            self.framebuffer = GL.glGenFramebuffers(1)
            GL.glBindFramebuffer(GL.GL_FRAMEBUFFER, self.framebuffer)
            self.stores = [int(s) for s in np.atleast_1d(GL.glGenRenderbuffers(self.targets + 1))]
            targets = [GL.GL_COLOR_ATTACHMENT0 + i for i in range(self.targets)]
            for store, kind, at in zip(
                self.stores,
                [*formats, GL.GL_DEPTH_COMPONENT32F],
                [*targets, GL.GL_DEPTH_ATTACHMENT],
                strict=True,
            ):
                GL.glBindRenderbuffer(GL.GL_RENDERBUFFER, store)
                GL.glRenderbufferStorage(GL.GL_RENDERBUFFER, kind, self.width, self.height)
                GL.glFramebufferRenderbuffer(GL.GL_FRAMEBUFFER, at, GL.GL_RENDERBUFFER, store)
            GL.glDrawBuffers(self.targets, targets)
            state = GL.glCheckFramebufferStatus(GL.GL_FRAMEBUFFER)
            if state != GL.GL_FRAMEBUFFER_COMPLETE:
                raise RenderError(
                    f"OpenGL refuses a {self.width}x{self.height} geometry buffer (state {int(state):#x})",
                    "the rays back end needs no OpenGL: --set raster.backend=rays",
                )
        GL.glBindFramebuffer(GL.GL_FRAMEBUFFER, self.framebuffer)
        GL.glViewport(0, 0, width, height)

    def bind_peel(self, depth: np.ndarray, width: int, height: int) -> None:
        from OpenGL import GL

        if self.peel is None:
            self.peel = GL.glGenTextures(1)
        GL.glActiveTexture(GL.GL_TEXTURE0 + 7)
        GL.glBindTexture(GL.GL_TEXTURE_2D, self.peel)
        data = np.ascontiguousarray(depth, np.float32)
        GL.glTexImage2D(
            GL.GL_TEXTURE_2D, 0, GL.GL_R32F, width, height, 0, GL.GL_RED, GL.GL_FLOAT, data
        )
        for name in (GL.GL_TEXTURE_MIN_FILTER, GL.GL_TEXTURE_MAG_FILTER):
            GL.glTexParameteri(GL.GL_TEXTURE_2D, name, GL.GL_NEAREST)

    def read(self, width: int, height: int) -> list[np.ndarray]:
        """geometry float32, albedo uint16, material uint16 with the part number raw, emissive float32; (n, 4) each."""
        from OpenGL import GL

        out = [
            np.empty((height * width, 4), t)
            for t in (np.float32, np.uint16, np.uint16, np.float32)[: self.targets]
        ]
        for i, a in enumerate(out):
            GL.glReadBuffer(GL.GL_COLOR_ATTACHMENT0 + i)
            kind = GL.GL_FLOAT if a.dtype == np.float32 else GL.GL_UNSIGNED_SHORT
            GL.glReadPixels(0, 0, width, height, GL.GL_RGBA, kind, a)
        return [*out, np.zeros((1, 4), np.float32)][:4]

    def free(self) -> None:
        from OpenGL import GL

        if self.framebuffer is not None:
            GL.glDeleteFramebuffers(1, [self.framebuffer])
            GL.glDeleteRenderbuffers(len(self.stores), self.stores)
            self.framebuffer = None
        if self.peel is not None:
            GL.glDeleteTextures([self.peel])
            self.peel = None


class _Part:
    """One part: its pyrender primitive and textures, its defines and uniforms."""

    def __init__(self, pyrender: Any, mesh: Mesh, part: int, textures: dict[int, Any]) -> None:
        faces = mesh.faces[mesh.part == part]
        used, local = np.unique(faces, return_inverse=True)
        kind, row = mesh.ints[part], mesh.floats[part]
        names = ("BASE_TEX", "MR_TEX", "EMISSIVE_TEX")
        self.textures = {n: textures[t] for n, t in zip(names, kind[:3], strict=True) if t >= 0}
        uv, colours = mesh.uv[used], mesh.colours[used]
        self.primitive = pyrender.Primitive(
            positions=mesh.vertices[used].astype(np.float32),
            normals=mesh.normals[used],
            texcoord_0=np.stack([uv[:, 0], 1 - uv[:, 1]], 1) if self.textures else None,
            color_0=colours if (colours != 1).any() else None,
            indices=local.reshape(-1, 3).astype(np.uint32),
        )
        self.primitive._add_to_context()
        self.count = local.size
        self.two_sided = bool(kind[columns.TWO_SIDED])
        at = 2
        self.defines: dict[str, int] = {"NORMAL_LOC": 1}
        if self.textures:
            self.defines["TEXCOORD_0_LOC"], at = at, at + 1
        if self.primitive.color_0 is not None:
            self.defines["COLOR_0_LOC"], at = at, at + 1
        self.defines["INST_M_LOC"] = at
        self.defines.update(dict.fromkeys(self.textures, 1))
        self.uniforms = {
            "base_factor": row[: columns.ALPHA + 1],
            "surface": row[[columns.METALLIC, columns.ROUGHNESS, columns.SPECULAR]],
            "emissive_factor": row[columns.EMIT_R : columns.CUTOFF],
            "kind": np.array([part + 1, kind[columns.MODE], row[columns.CUTOFF]], np.float32),
        }

    def __call__(
        self,
        programs: Any,
        view: np.ndarray,
        projection: np.ndarray,
        eye: np.ndarray,
        peels: bool,
        glows: bool,
    ) -> None:
        from OpenGL import GL

        defines = {
            **self.defines,
            **({"PEEL": 1} if peels else {}),
            **({"GLOWS": 1} if glows else {}),
        }
        program = programs.get_program("gbuffer.vert", "gbuffer.frag", defines=defines)
        if not program._in_context():
            program._add_to_context()
        program._bind()
        uniforms: dict[str, Any] = {"V": view, "P": projection, "eye": eye, **self.uniforms}
        for unit, (name, texture) in enumerate(self.textures.items()):
            if name == "EMISSIVE_TEX" and not glows:
                continue
            GL.glActiveTexture(GL.GL_TEXTURE0 + unit)
            texture._bind()
            uniforms[name.lower()] = unit
        if not glows:
            uniforms.pop("emissive_factor")
        if peels:
            uniforms["peel"] = 7
        for name, value in uniforms.items():
            program.set_uniform(name, value)
        if self.two_sided:
            GL.glDisable(GL.GL_CULL_FACE)
        else:
            GL.glEnable(GL.GL_CULL_FACE)
            GL.glCullFace(GL.GL_BACK)
        self.primitive._bind()
        GL.glDrawElements(GL.GL_TRIANGLES, self.count, GL.GL_UNSIGNED_INT, ctypes.c_void_p(0))
        self.primitive._unbind()
        program._unbind()
