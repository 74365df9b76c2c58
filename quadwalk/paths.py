"""Where the package's assets are."""

from pathlib import Path

_PACKAGE = Path(__file__).resolve().parent

# A wheel carries assets/ inside the package; a checkout keeps it at the top level.
ASSETS = _PACKAGE / "assets" if (_PACKAGE / "assets").is_dir() else _PACKAGE.parent / "assets"
ALIENGO_URDF = ASSETS / "aliengo.urdf"
PRETRAINED = ASSETS / "pretrained"  # runs that come with the package: policy and robot
