"""Frames as raw bytes and back: the packets of the sensor, or the points where a source has no packets."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict
from functools import partial
from typing import Any

import msgspec

from common.bus.raw_tap import RawTap
from common.config import ConfigError
from common.recording.raw import replayed
from common.source_url import SourceUrl
from common.topics import INFRA_RAW
from services.infra_lidar.input.hesai_calibration import CalibrationError
from services.infra_lidar.input.models import decoder_of
from services.infra_lidar.input.ouster_metadata import MetadataError
from services.infra_lidar.input.packets import Frame
from services.infra_lidar.input.revolution import PacketDecoder, decode_revolution, stack_packets
from services.infra_lidar.sensor_health import FrameQuality


def publish_raw(raw: RawTap, stamp_ns: int, frame: Frame) -> None:
    """Publish one frame as it came: its packets as (P, B) uint8, else its points (N, 3..5) float32."""
    about: dict[str, Any] = {"quality": asdict(frame.quality), "metadata": frame.metadata}
    if not frame.packets:
        raw("points", stamp_ns, frame.points, frame.received_ns, **about)
        return
    raw(frame.kind, stamp_ns, partial(stack_packets, frame.packets), frame.received_ns, **about)


def recorded_frames(url: SourceUrl) -> Iterator[tuple[int, Frame]]:
    """Frames of ``spotter record --raw infra_lidar``, decoded from their packets again.

    Each with the sensor and calibration it was recorded with; a service that starts anew may have others.

    Raises:
        ConfigError: no recording, one without raw bytes of this sensor, or of a kind that is not known.
    """
    decoder: PacketDecoder | None = None
    sensor: tuple[str, str] | None = None
    for piece in replayed(url, INFRA_RAW):
        try:
            quality = msgspec.convert(piece.about.get("quality", {}), FrameQuality)
            if piece.kind == "points":
                yield piece.stamp_ns, Frame(piece.data, piece.received_ns, quality)
                continue
            metadata = str(piece.about.get("metadata", ""))
            if decoder is None or sensor != (piece.kind, metadata):  # also where the service has started anew
                decoder, sensor = decoder_of(piece.kind, metadata), (piece.kind, metadata)
            packets = [packet.tobytes() for packet in piece.data]
            returns = decode_revolution(piece.data, decoder)
        except (msgspec.ValidationError, MetadataError, CalibrationError, KeyError) as error:
            raise ConfigError(f"source {url}: {error}") from None
        yield piece.stamp_ns, Frame(returns, piece.received_ns, quality, packets, metadata, piece.kind)
