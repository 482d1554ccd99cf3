"""The `pyrender` back end: a float geometry buffer through pyrender's meshes, textures and shader cache.

Each pixel gets k x k samples of an ideal camera over the rectangle only (cx, cy shifted by its corner); with lens distortion
the ideal picture is made as wide as the rectangle needs, and every sample looks up the texel its exact direction points to
(gl_resolve.py). BLEND materials are peeled front to back, up to MAX_LAYERS. Textures: OpenGL's mipmaps, averaged in coded
values. The near plane stands at 9/10 of the nearest vertex, at least NEAR_M; what is nearer is cut away.
"""

from __future__ import annotations

import ctypes
import os
import weakref
from typing import Any

import numpy as np

from arfx.core.camera import Camera
from arfx.core.layers import Layer, neutral
from arfx.core.pose import Pose
from arfx.core.rect import Rect
from arfx.errors import InputError, RenderError
from arfx.stages.raster import gl_resolve, hits
from arfx.stages.raster import mesh as columns
from arfx.stages.raster.gl_context import GlContext, open_context
from arfx.stages.raster.gl_shaders import shader_folder
from arfx.stages.raster.lens import LensTable
from arfx.stages.raster.mesh import Mesh
from arfx.stages.raster.rays import OUTPUTS

MAX_LAYERS = 8
NEAR_M = 1e-3
# A viewport above 16384 breaks the driver for good (FINDINGS.md); this area keeps the buffers under 1 GB.
MAX_SIDE_PX = 8192
MAX_AREA_PX = 24_000_000
MAX_PARTS = 65_534


class GlRenderer:
    """Renders rectangles of one mesh through one camera. samples : per pixel, rounded to a square k x k.

    Raises RenderError where no OpenGL context opens, InputError for more than MAX_PARTS parts.
    """

    any_rectangle = False  # the driver's fixed-point edges depend on the viewport's corner

    def __init__(self, mesh: Mesh, camera: Camera, samples: int) -> None:
        if len(mesh.ints) > MAX_PARTS:
            raise InputError(
                f"the model has {len(mesh.ints)} parts", f"at most {MAX_PARTS} with OpenGL; --set raster.backend=rays"
            )
        self.mesh, self.camera, self.lens = mesh, camera, LensTable(camera)
        self.k = max(round(samples**0.5), 1)
        offset = (np.arange(self.k) + 0.5) / self.k - 0.5
        radius = (offset[:, None] ** 2 + offset[None] ** 2).ravel()
        self.order = np.argsort(radius, kind="stable")
        self.glows = bool(mesh.floats[:, columns.EMIT_R : columns.CUTOFF].any())
        self.blends = bool((mesh.ints[:, columns.MODE] == 2).any())
        self.context = open_context()
        self.context.make_current()
        self.buffer = _Buffer(4 if self.glows else 3)
        self.draws = _upload(self.context, mesh)
        from pyrender.shader_program import ShaderProgramCache

        self.programs = ShaderProgramCache(shader_dir=shader_folder())
        weakref.finalize(self, _free, os.getpid(), self.context, self.draws, self.buffer)

    def render(self, rect: Rect, camera_from_world: Pose) -> dict[Layer, np.ndarray]:
        """All layers over `rect`, which lies in the frame. Raises RenderError where the driver refuses."""
        out = {name: neutral(name, rect) for name in OUTPUTS}
        if rect.empty:
            return out
        rows = max(min(MAX_SIDE_PX // self.k, MAX_AREA_PX // (self.k**2 * rect.width)), 1)
        for top in range(rect.y0, rect.y1, rows):
            strip = Rect(rect.x0, top, rect.x1, min(top + rows, rect.y1))
            self._strip(strip, camera_from_world, [out[name][strip.slices_in(rect)] for name in OUTPUTS])
        return out

    def _strip(self, rect: Rect, pose: Pose, outs: list[np.ndarray]) -> None:
        camera_from_mesh = Pose(pose.rotation, pose.apply(self.mesh.centre_m))
        depths = camera_from_mesh.apply(self.mesh.vertices)[:, 2]
        near, far = max(0.9 * float(depths.min()), NEAR_M), 1.1 * float(depths.max())
        lens = self.lens.directions(rect.pad(1))
        place = self._place(rect, lens)
        if far <= near or place is None:
            return
        scale, shift, columns_px, rows_px = place
        rotation = np.ascontiguousarray(pose.rotation)
        eye = pose.inverse().translation_m
        h, w, per = rect.height, rect.width, self.k**2
        directions, _ = hits.world_directions(lens[1:-1, 1:-1], rotation)
        texels = gl_resolve.texel_map(lens, h, w, self.k, scale, shift, rows_px, columns_px, not self.camera.distorted)
        self.context.make_current()
        view, projection = np.diag([1.0, -1, -1, 1]) @ camera_from_mesh.matrix, self._projection(place, near, far)
        grid = np.array([*scale, *shift, columns_px if self.camera.distorted else 0, rows_px], float)
        if not self.blends:
            buffers = self._draw(view, projection, columns_px, rows_px, None)
            rest = (*buffers, self.glows, grid, rotation, directions, eye, h, w, *outs)
            gl_resolve.resolve_opaque(texels, self.order, per, *rest)
            return
        acc = np.zeros((h * w * per, hits.COLUMNS), np.float32)
        acc[:, 0] = 1
        depth, ident = np.full(len(acc), np.inf, np.float32), np.zeros(len(acc), np.int32)
        peel = None
        for _ in range(MAX_LAYERS):
            buffers = self._draw(view, projection, columns_px, rows_px, peel)
            if not gl_resolve.add_layer(texels, per, *(*buffers, self.glows, grid, rotation, directions, acc, depth, ident)):
                break
            # nothing drawn at a texel: everything there has been peeled
            peel = np.where(buffers[2][:, 3] > 0, buffers[0][:, 3], np.float32(3e38))
        # pixels are numbered with a margin of one, the lens table has two
        ys, xs = np.divmod(np.arange(h * w), w)
        numbers = (ys + 1) * (w + 2) + xs + 1
        none = np.zeros((h + 2) * (w + 2), np.int32)
        rest = (self.lens.directions(rect.pad(2)), rotation, eye, *outs)
        hits.resolve_edges(w + 2, numbers, per, self.order, acc, depth, ident, none.astype(np.float32), none, *rest)

    def _place(self, rect: Rect, lens: np.ndarray) -> tuple[np.ndarray, np.ndarray, int, int] | None:
        """Ideal camera of the buffer: position = direction * scale + shift; its size. None where nothing is seen."""
        c, k = self.camera, self.k
        focal, centre = np.array([c.fx, c.fy]), np.array([c.cx, c.cy])
        if not c.distorted:
            corner = np.array([rect.x0, rect.y0])
            return focal * k, (centre - corner) * k + (k - 1) / 2, rect.width * k, rect.height * k
        if np.isnan(lens).all():
            return None
        low, high = np.nanmin(lens, (0, 1)).astype(float), np.nanmax(lens, (0, 1)).astype(float)
        scale = focal * k
        size = (high - low) * scale + 2
        # A wide lens would need an endless ideal picture: it is made coarser instead.
        scale = scale * min(1.0, *(MAX_SIDE_PX / size), np.sqrt(MAX_AREA_PX / size.prod()))
        size = np.minimum(np.ceil((high - low) * scale).astype(int) + 2, MAX_SIDE_PX)
        # The buffer's grid is fixed to the picture, not to the rectangle.
        first = np.floor(low * scale + centre * k)
        return scale, centre * k - first, int(size[0]), int(size[1])

    def _projection(self, place: tuple[np.ndarray, np.ndarray, int, int], near: float, far: float) -> np.ndarray:
        scale, shift, width, height = place
        camera = self.context.pyrender.IntrinsicsCamera(scale[0], scale[1], shift[0] + 0.5, shift[1] + 0.5, near, far)
        return camera.get_projection_matrix(width, height)

    def _draw(
        self, view: np.ndarray, projection: np.ndarray, width: int, height: int, peel: np.ndarray | None
    ) -> list[np.ndarray]:
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
        for draw in self.draws:
            draw(self.programs, view, projection, eye, peel is not None, self.glows)
        return self.buffer.read(width, height)


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
            self.width, self.height = max(self.width, -(-width // 64) * 64), max(self.height, -(-height // 64) * 64)
            formats = [GL.GL_RGBA32F, GL.GL_RGBA16, GL.GL_RGBA16, GL.GL_RGBA16F][: self.targets]
            self.framebuffer = GL.glGenFramebuffers(1)
            GL.glBindFramebuffer(GL.GL_FRAMEBUFFER, self.framebuffer)
            self.stores = [int(s) for s in np.atleast_1d(GL.glGenRenderbuffers(self.targets + 1))]
            places = [GL.GL_COLOR_ATTACHMENT0 + i for i in range(self.targets)]
            for store, kind, at in zip(
                self.stores, [*formats, GL.GL_DEPTH_COMPONENT32F], [*places, GL.GL_DEPTH_ATTACHMENT], strict=True
            ):
                GL.glBindRenderbuffer(GL.GL_RENDERBUFFER, store)
                GL.glRenderbufferStorage(GL.GL_RENDERBUFFER, kind, self.width, self.height)
                GL.glFramebufferRenderbuffer(GL.GL_FRAMEBUFFER, at, GL.GL_RENDERBUFFER, store)
            GL.glDrawBuffers(self.targets, places)
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
        GL.glTexImage2D(GL.GL_TEXTURE_2D, 0, GL.GL_R32F, width, height, 0, GL.GL_RED, GL.GL_FLOAT, data)
        for name in (GL.GL_TEXTURE_MIN_FILTER, GL.GL_TEXTURE_MAG_FILTER):
            GL.glTexParameteri(GL.GL_TEXTURE_2D, name, GL.GL_NEAREST)

    def read(self, width: int, height: int) -> list[np.ndarray]:
        """geometry float32, albedo uint16, material uint16 with the part number raw, emissive float32; (n, 4) each."""
        from OpenGL import GL

        out = []
        kinds = [
            (np.float32, GL.GL_FLOAT),
            (np.uint16, GL.GL_UNSIGNED_SHORT),
            (np.uint16, GL.GL_UNSIGNED_SHORT),
            (np.float32, GL.GL_FLOAT),
        ]
        for i, (dtype, kind) in enumerate(kinds):
            if i >= self.targets:
                out.append(np.zeros((1, 4), np.float32))
                continue
            a = np.empty((height * width, 4), dtype)
            GL.glReadBuffer(GL.GL_COLOR_ATTACHMENT0 + i)
            GL.glReadPixels(0, 0, width, height, GL.GL_RGBA, kind, a)
            out.append(a)
        return out

    def free(self) -> None:
        from OpenGL import GL

        if self.framebuffer is not None:
            GL.glDeleteFramebuffers(1, [self.framebuffer])
            GL.glDeleteRenderbuffers(len(self.stores), self.stores)
            self.framebuffer = None


class _Draw:
    """One part: its pyrender primitive and textures, its defines and uniforms."""

    def __init__(self, context: GlContext, mesh: Mesh, part: int, textures: dict[int, Any]) -> None:
        faces = mesh.faces[mesh.part == part]
        used, local = np.unique(faces, return_inverse=True)
        kind, row = mesh.ints[part], mesh.floats[part]
        names = ("BASE_TEX", "MR_TEX", "EMISSIVE_TEX")
        self.textures = {n: textures[t] for n, t in zip(names, kind[:3], strict=True) if t >= 0}
        uv = mesh.uv[used]
        colours = mesh.colours[used]
        self.primitive = context.pyrender.Primitive(
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
        self, programs: Any, view: np.ndarray, projection: np.ndarray, eye: np.ndarray, peels: bool, glows: bool
    ) -> None:
        from OpenGL import GL

        defines = {**self.defines, **({"PEEL": 1} if peels else {}), **({"GLOWS": 1} if glows else {})}
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


def _upload(context: GlContext, mesh: Mesh) -> list[_Draw]:
    textures: dict[int, Any] = {}
    for t, row in enumerate(mesh.textures.table):
        w, h, start = int(row[0]), int(row[1]), int(row[3])
        picture = mesh.textures.texels[start : start + w * h].reshape(h, w, 4)
        textures[t] = context.pyrender.Texture(source=picture, source_channels="RGBA")
        textures[t]._add_to_context()
    return [_Draw(context, mesh, part, textures) for part in range(len(mesh.ints))]


def _free(pid: int, context: GlContext, draws: list[_Draw], buffer: _Buffer) -> None:
    """Give the driver's memory back; not in another process, nor while the interpreter is shutting down."""
    import sys

    if pid != os.getpid() or sys.is_finalizing():
        return
    context.make_current()
    buffer.free()
    for texture in {id(t): t for d in draws for t in d.textures.values()}.values():
        texture._remove_from_context()
    for d in draws:
        d.primitive._remove_from_context()
