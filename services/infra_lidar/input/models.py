"""The table of sensors that are read. No I/O: what one needs beside its packets comes as text, its ``metadata``."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple, Never

from services.infra_lidar.input import hesai_calibration, ouster, robosense, velodyne
from services.infra_lidar.input.hesai import hesai_format, silent_packet
from services.infra_lidar.input.hesai_parser import HesaiParser
from services.infra_lidar.input.ouster import OusterFormat, OusterParser
from services.infra_lidar.input.revolution import PacketDecoder, decode_revolution, stack_packets
from services.infra_lidar.input.robosense import robosense_format
from services.infra_lidar.input.sensors import OUSTER, PANDAR128, QT128, RUBY, RUBY_PLUS, VLS128
from services.infra_lidar.input.spinning import PacketParser, SpinningParser


class Kind(NamedTuple):
    """Sensors of one packet protocol.

    models: how the names of ``sensors.model_of`` begin. port: UDP, as they leave the factory. parser: makes a parser
    from the metadata that the packets need and the azimuth (degrees) where revolutions are cut. decoder: makes a
    decoder from metadata. to_count: stand-in metadata with which packets and returns can be counted, but whose points
    are wrong; "" = there are none.
    """

    models: tuple[str, ...]
    port: int
    parser: Callable[[str, float], PacketParser]
    decoder: Callable[[str], PacketDecoder]
    to_count: str = ""


KINDS = {
    "velodyne": Kind((VLS128,), 2368, lambda _, cut: velodyne.Vls128Parser(cut), lambda _: velodyne.DECODER),
    "ouster": Kind(
        (OUSTER,),
        7502,
        lambda metadata, _: OusterParser(OusterFormat(metadata)),
        lambda metadata: ouster.decoder(OusterFormat(metadata)),
    ),
    "hesai": Kind(
        (PANDAR128, QT128),
        2368,
        HesaiParser,
        lambda metadata: hesai_format(metadata).decoder,
        hesai_calibration.unknown_angles(),
    ),
    "robosense": Kind(
        (RUBY_PLUS, RUBY),
        6699,
        lambda metadata, cut: SpinningParser(robosense_format(metadata), cut),
        lambda metadata: robosense_format(metadata).decoder,
        robosense.unknown_angles(),
    ),
}


SILENT_PACKETS = {  # without a return; an Ouster's depend on its metadata
    "velodyne": bytes(velodyne.PACKET_BYTES),
    "hesai": silent_packet(),
    "robosense": bytes(robosense.PACKET_BYTES),
}


def compile_decoder(kind: str) -> None:
    """Decode a packet without returns, so that live packets need not wait for the compiler."""
    if kind == "ouster":
        layout = ouster.smallest_format()
        packet, decoder = bytes(layout.packet_bytes), ouster.decoder(layout)
    else:
        packet, decoder = SILENT_PACKETS[kind], decoder_of(kind, KINDS[kind].to_count)
        KINDS[kind].parser(KINDS[kind].to_count, 0.0).feed(packet, 0)
    decode_revolution(stack_packets([packet]), decoder)


def kind_of(model: str) -> str:
    """The kind of a model that is read.

    Raises:
        KeyError: it is not.
    """
    return next((name for name, kind in KINDS.items() if model.startswith(kind.models)), None) or _unknown(model)


def decoder_of(kind: str, metadata: str) -> PacketDecoder:
    """For packets of one sensor.

    Raises:
        KeyError: there is no such kind.
        ValueError: the metadata are not of that kind.
    """
    return KINDS[kind].decoder(metadata) if kind in KINDS else _unknown(kind)


def _unknown(what: str) -> Never:
    raise KeyError(f"{what}: expected a sensor of {', '.join(KINDS)}")
