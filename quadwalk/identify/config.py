"""The options of `quadwalk identify`."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

import tyro

from quadwalk.bounds import Bounds, NotNegative, Positive, Settings
from quadwalk.errors import UsageError
from quadwalk.settings.training import RobotConfig

Constant = Literal["armature", "friction", "damping", "delay", "kp", "kd"]


@dataclass(frozen=True)
class IdentifyConfig(Settings):
    """Fit the joints of a robot on a stand to a log of their targets and angles.

    Begin with --targets FILE, which writes targets to play on the robot.
    """

    # the log: an MCAP file, or a CSV with the columns time, target_JOINT and position_JOINT
    log: Annotated[Path | None, tyro.conf.Positional, tyro.conf.arg(metavar="[LOG]")] = None
    targets: Path | None = None  # write joint targets for a recording to this CSV, and end
    # folder for the results; None: LOG_identified, beside it
    out: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None
    kp: Positive | None = None  # Nm/rad, position gain of the recording; None: that of training
    kd: NotNegative | None = None  # Nm s/rad, its velocity gain; None: that of training
    # constants to fit
    fit: tuple[Constant, ...] = ("armature", "friction", "damping", "delay")
    per_joint: bool = False  # fit every joint by itself, not hips, thighs and calves
    # share of the log, its end, that is not fitted and shows how well the fit predicts
    hold_out: Annotated[float, Bounds(0.0, 0.8)] = 0.2
    robot: RobotConfig = field(default_factory=RobotConfig)

    def __post_init__(self) -> None:
        super().__post_init__()
        if (self.log is None) == (self.targets is None):
            raise UsageError("expected either a log, or --targets FILE to write targets to")
        if not self.fit:
            raise UsageError("--fit names nothing; expected one or more constants")
        if {"kd", "damping"} <= set(self.fit):
            raise UsageError(
                "--fit names kd and damping; expected one of them: a log shows only their sum"
            )
