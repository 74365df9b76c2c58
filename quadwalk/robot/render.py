"""A picture of a robot in its home pose, drawn offscreen on a CPU."""

import ctypes.util
import os
import struct
import sys
import zlib
from typing import TYPE_CHECKING

from quadwalk.errors import UserError

if TYPE_CHECKING:
    import mujoco
    import numpy as np

NEEDS = "drawing without a display needs OSMesa: apt-get install libosmesa6"


def choose_backend() -> None:
    """Without a display or a choice in `MUJOCO_GL`, draw with OSMesa.

    `mujoco.Renderer` goes by what the variable was when mujoco was first imported: who draws with
    that calls this before.
    """
    if sys.platform != "linux" or any(
        os.environ.get(name) for name in ("MUJOCO_GL", "DISPLAY", "WAYLAND_DISPLAY")
    ):
        return
    if ctypes.util.find_library("OSMesa") is None:
        raise UserError(NEEDS)
    os.environ["MUJOCO_GL"] = "osmesa"


def render_home(
    model: "mujoco.MjModel",
    width: int = 1280,
    height: int = 800,
    azimuth: float = 140.0,
    elevation: float = -16.0,
    scale: float = 1.0,
) -> "np.ndarray":
    """(height, width, 3) uint8 picture of the keyframe `home`, seen from ahead and above.

    Args:
        model: compiled, with its visual shapes.
        width, height: pixels.
        azimuth, elevation: degrees, MuJoCo's camera angles; the camera looks at the robot.
        scale: distance of the camera, 1 shows the whole robot.
    """
    import mujoco
    import numpy as np

    model.vis.global_.offwidth = max(model.vis.global_.offwidth, width)
    model.vis.global_.offheight = max(model.vis.global_.offheight, height)
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_forward(model, data)
    shapes = model.geom_bodyid > 0
    reach = model.geom_rbound[shapes, None]
    low = (data.geom_xpos[shapes] - reach).min(axis=0)
    high = (data.geom_xpos[shapes] + reach).max(axis=0)
    camera = mujoco.MjvCamera()
    # The whole robot fits across the picture, and within its 45 degrees of height; what is near,
    # its feet, takes more room than what is far.
    size = high - low
    camera.lookat = (low + high) / 2 - [0, 0, 0.12 * size[2]]
    camera.distance = scale * float(max(1.1 * np.linalg.norm(size), 1.6 * size[2]))
    camera.azimuth, camera.elevation = azimuth, elevation
    try:
        renderer = mujoco.Renderer(model, height, width)
    except Exception as error:  # the backends raise what they like: ImportError, FatalError, ...
        reason = " ".join(str(error).split())
        raise UserError(f"cannot draw ({reason}); {NEEDS}") from None
    try:
        renderer.update_scene(data, camera)
        return renderer.render()
    finally:
        renderer.close()


def png_bytes(pixels: "np.ndarray") -> bytes:
    """A PNG of (height, width, 3) uint8 pixels, the same bytes for the same pixels."""
    height, width, _ = pixels.shape
    rows = b"".join(b"\0" + row.tobytes() for row in pixels)

    def chunk(kind: bytes, body: bytes) -> bytes:
        checksum = zlib.crc32(kind + body)
        return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", checksum)

    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    return b"".join(
        [
            b"\x89PNG\r\n\x1a\n",
            chunk(b"IHDR", header),
            chunk(b"IDAT", zlib.compress(rows, 9)),
            chunk(b"IEND", b""),
        ]
    )
