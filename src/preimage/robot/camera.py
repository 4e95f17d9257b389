"""Grey frames of the simulated table by casting rays: no OpenGL, no display, the same bits on every machine.

One ray goes through the middle of every pixel; where it meets something other than its neighbours do, nine rays take its place. A
second ray from the lamp to the point that was met shows whether it lies in shadow.

>>> Camera(height=48, width=80).rays(1).shape
(3840, 1, 3)
"""

# pyright: reportAttributeAccessIssue=false
# mujoco ships no stubs for its compiled names.

from dataclasses import dataclass

import mujoco
import numpy as np
from jaxtyping import Float, UInt8

AMBIENT = 0.55
"""Share of a surface's grey that is seen without any light falling on it."""
SHADOW = 0.25
"""Share of the lamp's light that is left in its shadow."""
BACKGROUND = 0.22
"""Grey where a ray meets nothing."""
EDGE = 0.06
"""Neighbouring greys that differ more than this count as an edge."""
RAYS_ACROSS_EDGE = 3
"""Rays along each side of a pixel that lies on an edge."""
SHADOW_GAP_M = 0.005
"""What the lamp meets nearer than this to a point is the point itself (m)."""
FAR_M = 100.0
"""Rays end here (m)."""
LUMA = (0.299, 0.587, 0.114)


@dataclass(frozen=True)
class Camera:
    """Where the camera stands, where it looks and how large its frames are. The default sees the 74 cm table.

    Raises:
        ValueError: it has no direction to look, or no picture to take.
    """

    position_m: tuple[float, float, float] = (0.85, 0.0, 1.5)
    """Position in the frame of the table (m)."""
    target_m: tuple[float, float, float] = (0.34, 0.0, 0.05)
    """The point in the middle of the frame (m)."""
    fovy_deg: float = 33.5
    """Angle of view from the upper to the lower edge of the frame (degrees)."""
    height: int = 64
    """Rows of pixels."""
    width: int = 64
    """Columns of pixels."""

    def __post_init__(self) -> None:
        if self.position_m[:2] == self.target_m[:2]:
            raise ValueError(f"target_m {self.target_m} lies straight above or below position_m: move one a little in x")
        if not 0 < self.fovy_deg < 180:
            raise ValueError(f"fovy_deg is {self.fovy_deg}: give an angle between 0 and 180")
        if self.height < 1 or self.width < 1:
            raise ValueError(f"height {self.height} and width {self.width}: give at least one pixel each way")

    def rays(self, across: int) -> Float[np.ndarray, "pixels rays 3"]:
        """Unit vectors from the camera through every pixel, row by row: `across` times `across` rays in each."""
        rows, columns = _through_pixels(self.height, across), _through_pixels(self.width, across)
        up, right = np.meshgrid(-rows / self.height, columns / self.height, indexing="ij")
        tangent = 2 * np.tan(np.radians(self.fovy_deg) / 2)
        seen = np.stack([right * tangent, up * tangent, -np.ones_like(up)], axis=-1) @ self._axes()
        seen /= np.linalg.norm(seen, axis=-1, keepdims=True)
        seen = seen.reshape(self.height, across, self.width, across, 3).swapaxes(1, 2)
        return seen.reshape(self.height * self.width, across * across, 3)

    def project(self, positions_m: Float[np.ndarray, "*batch 3"]) -> Float[np.ndarray, "*batch 2"]:
        """Where points (m) are seen: shares of the frame's width from the left and of its height from the top."""
        right, up, backwards = np.moveaxis((positions_m - np.array(self.position_m)) @ self._axes().T, -1, 0)
        tangent = 2 * np.tan(np.radians(self.fovy_deg) / 2)
        across, down = (each / (-backwards * tangent) for each in (right, -up))
        return np.stack([across * self.height / self.width + 0.5, down + 0.5], axis=-1)

    def place_at(self, seen: Float[np.ndarray, " 2"], height_m: float) -> Float[np.ndarray, " 3"] | None:
        """The point at a height (m) that is seen there, the inverse of `project`; None where the ray does not come down to it."""
        tangent = 2 * np.tan(np.radians(self.fovy_deg) / 2)
        across, down = (seen - 0.5) * tangent * np.array([self.width / self.height, 1])
        ray = np.array([across, -down, -1.0]) @ self._axes()
        eye = np.array(self.position_m)
        return eye + ray * (height_m - eye[2]) / ray[2] if ray[2] < 0 else None

    def _axes(self) -> Float[np.ndarray, "3 3"]:
        """Rows: the directions right, up and backwards of the camera in the frame of the table."""
        backwards = np.subtract(self.position_m, self.target_m)
        right = np.cross((0.0, 0.0, 1.0), backwards)
        axes = np.stack([right, np.cross(backwards, right), backwards])
        return axes / np.linalg.norm(axes, axis=1, keepdims=True)


class Renderer:
    """Takes the frames of one camera in one compiled model."""

    def __init__(self, camera: Camera, model: mujoco.MjModel) -> None:
        self._camera = camera
        self._model = model
        self._eye = np.array(camera.position_m)
        self._lamp = np.array(model.light("lamp").pos)
        self._greys = model.geom_rgba[:, :3].astype(np.float64) @ LUMA
        self._middle_rays = camera.rays(1)
        self._edge_rays = camera.rays(RAYS_ACROSS_EDGE)

    def frame(self, data: mujoco.MjData) -> UInt8[np.ndarray, "H W 1"]:
        """A new frame of the state whose kinematics `data` holds."""
        geoms, greys = self._cast(data, self._middle_rays)
        edges = self._edges(geoms, greys)
        pixels = greys[:, 0]
        pixels[edges] = self._cast(data, self._edge_rays[edges])[1].mean(axis=1)
        return np.round(pixels * 255).astype(np.uint8).reshape(self._camera.height, self._camera.width, 1)

    def _cast(self, data: mujoco.MjData, rays: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Number of the geom that each ray meets (-1: none), and the grey seen there, from 0 to 1."""
        geoms, distances, normals = self._meet(data, self._eye, rays.reshape(-1, 3))
        to_lamp = self._lamp - (self._eye + rays.reshape(-1, 3) * distances[:, None])
        lamp_distances = np.linalg.norm(to_lamp, axis=1)
        to_lamp /= lamp_distances[:, None]
        light = np.clip((normals * to_lamp).sum(axis=1), 0, 1)
        _, free_m, _ = self._meet(data, self._lamp, -to_lamp)
        light = np.where((free_m >= 0) & (free_m < lamp_distances - SHADOW_GAP_M), SHADOW * light, light)
        greys = np.where(geoms >= 0, self._greys[geoms] * (AMBIENT + (1 - AMBIENT) * light), BACKGROUND)
        return geoms.reshape(rays.shape[:2]), greys.reshape(rays.shape[:2])

    def _meet(self, data: mujoco.MjData, start: np.ndarray, rays: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """What unit vectors from one point meet first: number of the geom, distance (m; -1: nothing) and surface normal."""
        num_rays = len(rays)
        geoms, distances, normals = np.empty(num_rays, np.int32), np.empty(num_rays), np.empty((num_rays, 3))
        mujoco.mj_multiRay(
            self._model,
            data,
            pnt=start,
            vec=rays.ravel(),
            geomgroup=None,
            flg_static=True,
            bodyexclude=-1,
            geomid=geoms,
            dist=distances,
            normal=normals.reshape(-1),
            nray=num_rays,
            cutoff=FAR_M,
        )
        return geoms, distances, normals

    def _edges(self, geoms: np.ndarray, greys: np.ndarray) -> np.ndarray:
        """The pixels (as one row of booleans) with a neighbour that shows another geom or another grey."""
        shape = self._camera.height, self._camera.width
        geoms, greys = geoms.reshape(shape), greys.reshape(shape)
        edges = np.zeros(shape, bool)
        below = (geoms[1:] != geoms[:-1]) | (np.abs(greys[1:] - greys[:-1]) > EDGE)
        beside = (geoms[:, 1:] != geoms[:, :-1]) | (np.abs(greys[:, 1:] - greys[:, :-1]) > EDGE)
        edges[1:] |= below
        edges[:-1] |= below
        edges[:, 1:] |= beside
        edges[:, :-1] |= beside
        return edges.ravel()


def _through_pixels(num_pixels: int, across: int) -> Float[np.ndarray, " rays"]:
    """Places of the rays along one side of the frame, in pixels from its middle."""
    return (np.arange(num_pixels * across) + 0.5) / across - num_pixels / 2
