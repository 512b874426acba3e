"""Revolutions as raw pieces and back: the packets of the sensor, or the points of a frame that never was in packets."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict
from functools import partial
from typing import Any

import msgspec

from common.config import ConfigError
from common.messages import RawBytes
from common.raw import RawTap
from common.recording.raw import replayed
from common.source_url import SourceUrl
from common.topics import INFRA_RAW
from services.infra_lidar import ouster, velodyne
from services.infra_lidar.blindness import FrameQuality
from services.infra_lidar.packet_source import Frame
from services.infra_lidar.revolutions import PacketDecoder, decode_turn, joined


def hand_over(raw: RawTap, stamp_ns: int, frame: Frame) -> None:
    """Give one frame to the tap: its packets as (P, B) uint8, else its points (N, 3..5) float32."""
    about: dict[str, Any] = {"quality": asdict(frame.quality), "metadata": frame.metadata}
    if not frame.packets:
        raw("points", stamp_ns, frame.points, frame.received_ns, **about)
        return
    kind = "ouster" if frame.metadata else "velodyne"
    raw(kind, stamp_ns, partial(joined, frame.packets), frame.received_ns, **about)


def recorded_frames(url: SourceUrl) -> Iterator[tuple[int, Frame]]:
    """Frames of ``spotter record --raw infra_lidar``, decoded from their packets again.

    Raises:
        ConfigError: no recording, one without raw bytes of this sensor, or of a kind that is not known.
    """
    decoder: PacketDecoder | None = None
    for piece in replayed(url, INFRA_RAW):
        try:
            quality = msgspec.convert(piece.about.get("quality", {}), FrameQuality)
            if piece.kind == "points":
                yield piece.stamp_ns, Frame(piece.data, piece.received_ns, quality)
                continue
            decoder = decoder or _decoder(piece)
            packets = [packet.tobytes() for packet in piece.data]
            returns = decode_turn(packets, decoder)
        except (msgspec.ValidationError, ouster.MetadataError) as error:
            raise ConfigError(f"source {url}: {error}") from None
        yield piece.stamp_ns, Frame(returns, piece.received_ns, quality, packets, str(piece.about.get("metadata", "")))


def _decoder(piece: RawBytes) -> PacketDecoder:
    if piece.kind == "velodyne":
        return velodyne.DECODER
    return ouster.decoder(ouster.OusterFormat(str(piece.about.get("metadata", ""))))
