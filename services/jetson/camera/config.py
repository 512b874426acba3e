"""What the camera service can be told. Every field has a default; camera.toml beside this file explains each key."""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec
from msgspec import Meta

from common.config import Section, ServiceConfig
from common.path import PathConfig
from common.source_url import source_kind

Pixels = Annotated[int, Meta(ge=32, le=8192)]
Fraction = Annotated[float, Meta(ge=0.0, le=1.0)]
Metres = Annotated[float, Meta(gt=0.0, le=100.0)]
Grey = Annotated[float, Meta(ge=0.0, le=255.0)]
Seconds = Annotated[float, Meta(gt=0.0, le=60.0)]
Frames = Annotated[int, Meta(ge=1, le=1000)]

Provider = Literal["TensorrtExecutionProvider", "CUDAExecutionProvider", "CPUExecutionProvider"]


class ClassSize(Section, frozen=True, kw_only=True):
    """Real size of a class. A length of 0: no vehicle, half as deep as it is wide."""

    height_m: Metres
    height_sigma_m: Metres
    width_m: Metres  # seen from its narrow side
    length_m: Annotated[float, Meta(ge=0.0, le=100.0)] = 0.0
    height_min_m: Annotated[float, Meta(ge=0.0, le=100.0)] = 0.0  # of the smallest; 0 = two spreads below the height

    @property
    def lowest_m(self) -> float:
        """Height of the smallest one to reckon with."""
        return self.height_min_m or max(self.height_m - 2 * self.height_sigma_m, 0.25 * self.height_m)


# Adults; the usual European fleet of road vehicles; "obstacle" is the smallest thing worth stopping for.
CLASS_SIZES = {
    "person": ClassSize(height_m=1.70, height_sigma_m=0.12, width_m=0.50, height_min_m=1.0),
    "bicycle": ClassSize(height_m=1.05, height_sigma_m=0.12, width_m=0.60, length_m=1.7),
    "motorcycle": ClassSize(height_m=1.15, height_sigma_m=0.15, width_m=0.75, length_m=2.0),
    "car": ClassSize(height_m=1.53, height_sigma_m=0.12, width_m=1.75, length_m=4.2),
    "bus": ClassSize(height_m=3.00, height_sigma_m=0.25, width_m=2.55, length_m=11.0),
    "truck": ClassSize(height_m=2.80, height_sigma_m=0.60, width_m=2.30, length_m=7.0),
    "dog": ClassSize(height_m=0.50, height_sigma_m=0.15, width_m=0.30),
    "chair": ClassSize(height_m=0.85, height_sigma_m=0.12, width_m=0.50),
    "suitcase": ClassSize(height_m=0.60, height_sigma_m=0.12, width_m=0.45),
    "obstacle": ClassSize(height_m=0.30, height_sigma_m=0.10, width_m=0.30),
}


class CaptureConfig(Section, frozen=True, kw_only=True):
    """How pictures are fetched. The child processes of ``csi:`` and ``v4l2:`` deliver raw BGR rows on their stdout."""

    width_px: Annotated[int, Meta(ge=32, le=8192, multiple_of=4)] = 640  # GStreamer pads rows to multiples of 4
    height_px: Pixels = 480
    rate_hz: Annotated[float, Meta(gt=0.0, le=120.0)] = 15.0  # sim: and picture folders
    sensor_width_px: Pixels = 1920  # csi: the sensor mode, before the picture is scaled
    sensor_height_px: Pixels = 1080
    sensor_rate_hz: Annotated[int, Meta(ge=1, le=240)] = 30
    rotate_deg: Literal[0, 90, 180, 270] = 0  # clockwise, until the picture is upright
    flip: Literal["none", "horizontal", "vertical"] = "none"  # after the turn; a camera that looks into a mirror
    start_timeout_s: Seconds = 8.0  # until the first frame of a child process
    frame_timeout_s: Seconds = 0.5  # between two frames; then the child is replaced, and a slow one waited for longer
    retry_min_s: Seconds = 0.2
    retry_max_s: Seconds = 5.0
    csi_command: tuple[str, ...] = ()  # replaces the built-in command; {width} {height} {rate} {device} are filled in
    v4l2_command: tuple[str, ...] = ()


class DetectorConfig(Section, frozen=True, kw_only=True):
    """The network: any ONNX file in a layout of ``network.py``."""

    model: str = ""  # path; empty = the demo network shipped beside this file, for `sim:` alone
    confidence: Fraction = 0.40
    iou: Fraction = 0.50  # boxes of one class that overlap more are one object
    classes: tuple[str, ...] = ()  # empty = every class of the network
    threads: Annotated[int, Meta(ge=1, le=64)] = 2
    providers: tuple[Provider, ...] = ("TensorrtExecutionProvider", "CUDAExecutionProvider", "CPUExecutionProvider")
    tensorrt_cache: str = (
        "auto"  # folder that keeps the engines TensorRT builds for minutes; empty = built at every start
    )
    dynamic_input_px: Annotated[int, Meta(ge=32, le=4096, multiple_of=32)] = 640  # for models without a fixed size


class LensConfig(Section, frozen=True, kw_only=True):
    """Pinhole calibration of upright pictures of this size; other shapes are taken as the same view, cut."""

    width_px: Pixels = 640
    height_px: Pixels = 480
    f_x_px: Annotated[float, Meta(gt=1.0, le=1e5)] = 397.0  # 3.9 mm lens on an IMX477, whole sensor to 640 x 480
    f_y_px: Annotated[float, Meta(gt=1.0, le=1e5)] = 397.0
    c_x_px: float = 320.0
    c_y_px: float = 240.0
    distortion: tuple[float, ...] = ()  # k1, k2, p1, p2, k3 (Brown's model, as in OpenCV); empty = none

    def __post_init__(self) -> None:
        if len(self.distortion) not in (0, 4, 5):
            raise ValueError(f"[lens] distortion: expected k1, k2, p1, p2, k3, found {len(self.distortion)} numbers")


class MountConfig(Section, frozen=True, kw_only=True):
    """Where the camera sits. A height of 0 means unknown: then only the class heights tell the distance."""

    height_m: Annotated[float, Meta(ge=0.0, le=20.0)] = 0.0  # above the ground
    pitch_rad: Annotated[float, Meta(ge=-1.2, le=1.2)] = 0.0  # nose up is positive
    height_sigma_m: Annotated[float, Meta(ge=0.0, le=5.0)] = 0.02
    pitch_sigma_rad: Annotated[float, Meta(ge=0.0, le=0.5)] = 0.02  # vehicle nodding, road slope


class DistanceConfig(Section, frozen=True, kw_only=True):
    """Real sizes by class, and how exactly a box is placed."""

    sizes: dict[str, ClassSize] = msgspec.field(default_factory=lambda: dict(CLASS_SIZES))
    edge: Annotated[float, Meta(ge=0.0, le=0.2)] = 0.02  # of the picture's height: a box so near its edge is cut off
    box_sigma_px: Annotated[float, Meta(ge=0.0, le=100.0)] = 2.0  # how well the network places one side of a box

    def size_of(self, label: str) -> ClassSize | None:
        """The size of a class; names are compared without case. None = not known."""
        return self.sizes.get(label) or next(
            (size for name, size in self.sizes.items() if name.casefold() == label.casefold()), None
        )


class ZoneConfig(Section, frozen=True, kw_only=True):
    """The forward zone and the bands. Limits are inclusive."""

    width: Fraction = 0.40  # the centre of the picture, as a fraction of its width
    min_overlap_px: Annotated[float, Meta(ge=0.0, le=1000.0)] = 1.0
    imminent_m: Metres = 0.5
    caution_m: Metres = 1.2
    imminent_height: Fraction = 0.95  # second trigger: the box's share of the picture's height
    caution_height: Fraction = 0.80
    camera_x_m: Annotated[float, Meta(ge=-10.0, le=10.0)] = 0.16  # of the lens, ahead of the vehicle's origin
    camera_y_m: Annotated[float, Meta(ge=-10.0, le=10.0)] = 0.0
    cover_far_m: Annotated[float, Meta(ge=0.0, le=100.0)] = 3.0  # up to here an obstacle of 0.3 m is recognised


class HealthConfig(Section, frozen=True, kw_only=True):
    """When a picture is no view. Grey levels are 0..255, measured on a picture reduced to 320 columns."""

    dark_below: Grey = 40.0  # mean brightness: detections are cleared at once
    saturated_above: Fraction = 0.50  # share of pixels at 250 or more
    contrast_below: Fraction = 0.15  # standard deviation over mean: a covered or fogged lens (real pictures: > 0.4)
    detail_below: Annotated[float, Meta(ge=0.0, le=10.0)] = (
        0.08  # Laplacian over contrast (real pictures: 0.3 and more)
    )
    slow_below_hz: Annotated[float, Meta(ge=0.0, le=100.0)] = 2.0  # pictures a second; 0 = never slow
    frozen_difference: Grey = 0.01  # mean difference to the picture before: sensor noise alone is far above
    frozen_after_s: Annotated[float, Meta(ge=0.0, le=60.0)] = 1.0  # 0 = never: for a still picture
    part_plain_below: Annotated[float, Meta(ge=0.0, le=100.0)] = 0.8  # grey levels of fine detail in a part
    part_plain_after_s: Annotated[float, Meta(gt=0.0, le=3600.0)] = 10.0  # a part without detail for so long is blind
    part_frozen_after_s: Annotated[float, Meta(ge=0.0, le=60.0)] = 1.0  # while others change; 0 = never: H.264 cameras
    part_blind_above: Fraction = 0.40  # share of such parts in a strip of the forward zone
    part_beside_above: Fraction = 0.65  # ... and in a strip beside it
    bands_above: Grey = 6.0  # grey levels by which whole rows change in bands from picture to picture
    hysteresis: Annotated[float, Meta(ge=0.0, le=1.0)] = 0.15  # a limit must be left by this share to count as good
    raise_frames: Frames = 5
    clear_frames: Frames = 3


class ImageConfig(Section, frozen=True, kw_only=True):
    """The published picture; it is made only while somebody listens."""

    rate_hz: Annotated[float, Meta(gt=0.0, le=30.0)] = 5.0
    quality: Annotated[int, Meta(ge=10, le=100)] = 80
    max_width_px: Pixels = 960


class CameraConfig(ServiceConfig, frozen=True, kw_only=True):
    """Everything that can be set for the camera; the defaults stand in ``camera.toml``."""

    host: Annotated[str, Meta(pattern=r"^[a-z0-9_]+$")] = "jetson0"
    source: str = ""
    ego_host: Annotated[str, Meta(pattern=r"^[a-z0-9_]+$")] = "jetson0"  # whose ego/motion is this vehicle's
    frame_id: str = "camera"
    capture: CaptureConfig = msgspec.field(default_factory=CaptureConfig)
    detector: DetectorConfig = msgspec.field(default_factory=DetectorConfig)
    lens: LensConfig = msgspec.field(default_factory=LensConfig)
    mount: MountConfig = msgspec.field(default_factory=MountConfig)
    distance: DistanceConfig = msgspec.field(default_factory=DistanceConfig)
    zone: ZoneConfig = msgspec.field(default_factory=ZoneConfig)
    path: PathConfig = msgspec.field(default_factory=PathConfig)
    health: HealthConfig = msgspec.field(default_factory=HealthConfig)
    image: ImageConfig = msgspec.field(default_factory=ImageConfig)

    def __post_init__(self) -> None:
        if self.zone.imminent_m > self.zone.caution_m:
            raise ValueError("[zone] imminent_m must not exceed caution_m")
        if self.zone.imminent_height < self.zone.caution_height:
            raise ValueError("[zone] imminent_height must not be below caution_height")
        if self.capture.retry_min_s > self.capture.retry_max_s:
            raise ValueError("[capture] retry_min_s must not exceed retry_max_s")
        if not self.distance.sizes:
            raise ValueError("[distance.sizes] must name at least one class")

    def check(self) -> None:
        """Refuse the demo network for anything but the simulated world; a recording of the bus is looked into later.

        Raises:
            ValueError: names the key and says how to get a network.
        """
        real = source_kind(self.source) in ("live", "recorded") and not self.source.startswith("mcap:")
        if real and not self.detector.model:
            raise ValueError(no_network(self.source))


def no_network(source: str) -> str:
    """What to do about a camera without a network of its own."""
    return (
        f'[detector] model = "": the demo network knows the simulated world alone, {source} shows the real one. Get a '
        "network: pip install ultralytics; yolo export model=yolo11n.pt format=onnx imgsz=640; then set detector.model"
    )
