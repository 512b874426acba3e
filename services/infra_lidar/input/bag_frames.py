"""Frames of a ROS bag: its clouds, or revolutions decoded from its packets."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from itertools import islice
from pathlib import Path

from common.bus.status import Report
from common.config import ConfigError
from common.source_url import SourceUrl
from services.infra_lidar.input import robosense
from services.infra_lidar.input.bags import CLOUD, Bag, BagError, BagTopic, open_bag, packets_of, points_in
from services.infra_lidar.input.calibration_files import DIFOP_WITHIN, captured_metadata
from services.infra_lidar.input.captures import CaptureError
from services.infra_lidar.input.hesai_calibration import CalibrationError
from services.infra_lidar.input.models import KINDS, kind_of
from services.infra_lidar.input.ouster_metadata import MetadataError
from services.infra_lidar.input.packets import Frame, Recorded, decoded
from services.infra_lidar.input.pcd import FrameError
from services.infra_lidar.input.sensors import OUSTER, SUPPORTED, Sender, model_of
from services.infra_lidar.input.spinning import PacketParser

log = logging.getLogger(__name__)


def bag_frames(path: Path, url: SourceUrl, report: Report) -> Callable[[], Iterator[Recorded]]:
    """The frames of one topic of a bag: of ``?topic=``, or of the only one that has any.

    Raises:
        ConfigError: no bag, damaged, no topic with clouds or with packets of a sensor that is supported, several, or an
            Ouster without metadata.
    """
    try:
        with open_bag(path) as bag:
            topic = choose_topic(bag, url)
            if topic.type == CLOUD:
                return lambda: _clouds(path, topic.name, report)
            new_parser = _parser_of(bag, topic, path, url)
    except BagError as error:
        ours = f"; what `spotter record` wrote is read as mcap:{path}" if path.suffix == ".mcap" else ""
        raise ConfigError(f"source {url}: {error}{ours}") from None
    return lambda: decoded(_packets(path, topic, report), new_parser(), report)


def choose_topic(bag: Bag, url: SourceUrl) -> BagTopic:
    """The topic that ``?topic=`` names, or the only one that can be read.

    Raises:
        ConfigError: there is none, or several.
    """
    found = bag.topics()
    asked = [one for one in found if url.params.get("topic", one.name) == one.name]
    readable = [one for one in asked if one.messages and (one.type == CLOUD or one.model.startswith(SUPPORTED))]
    if len(readable) == 1:
        return readable[0]
    if readable:
        raise ConfigError(f"source {url}: several topics: {'; '.join(map(str, readable))}. Choose one with ?topic=")
    there = "; ".join(map(str, asked)) or "; ".join(f"{name} ({kind})" for name, kind in bag.all_topics) or "nothing"
    raise ConfigError(
        f"source {url}: no {CLOUD} and no packets of a sensor that is supported ({', '.join(SUPPORTED)}); "
        f"in the bag: {there}"
    )


def _parser_of(bag: Bag, topic: BagTopic, path: Path, url: SourceUrl) -> Callable[[], PacketParser]:
    """A new parser for each time the bag is played. What its packets need is taken from the bag, if it is in it."""
    kind, cut_deg = kind_of(topic.model), url.number("cut", 0.0)
    try:
        metadata = _metadata_in(bag, topic, kind, url) or captured_metadata(Sender("", 0, topic.model), path, url)
        KINDS[kind].decoder(metadata)
    except (CaptureError, IsADirectoryError):  # a bag is no capture with the sensor's other port in it
        raise ConfigError(f"source {url}: no DIFOP packet in the bag: give the angles with ?calibration=FILE") from None
    except (MetadataError, CalibrationError) as error:
        raise ConfigError(f"source {url}: metadata in the bag: {error}") from None
    return lambda: KINDS[kind].parser(metadata, cut_deg)


def _metadata_in(bag: Bag, topic: BagTopic, kind: str, url: SourceUrl) -> str:
    """What the driver has recorded beside the packets; "" where the source names a file, or nothing is there."""
    if kind == "ouster" and "metadata" not in url.params:
        return bag.ouster_metadata()
    if kind == "robosense" and "calibration" not in url.params:
        for recorded_ns, message in islice(bag.messages(topic.name), DIFOP_WITHIN):
            for _, packet in packets_of(message, recorded_ns):
                if robosense.is_difop(packet):
                    return robosense.as_metadata(robosense.read_difop(packet))
    return ""


def _packets(path: Path, topic: BagTopic, report: Report) -> Iterator[tuple[int, bytes]]:
    """Up to where the bag is damaged: what came before has been played."""
    try:
        with open_bag(path) as bag:
            for recorded_ns, message in bag.messages(topic.name):
                for stamp_ns, packet in packets_of(message, recorded_ns):
                    if topic.model in (OUSTER, model_of(packet)):
                        yield stamp_ns, packet
    except BagError as error:
        log.warning("%s: %s", path, error)
        report.bad_input("damaged bag")


def _clouds(path: Path, topic: str, report: Report) -> Iterator[Recorded]:
    try:
        with open_bag(path) as bag:
            for recorded_ns, message in bag.messages(topic):
                try:
                    stamp_ns, points = points_in(message, recorded_ns)
                except FrameError as error:
                    log.warning("%s: %s: %s", path, topic, error)
                    report.bad_input("unreadable cloud")
                    continue
                yield stamp_ns / 1e9, Frame(points, 0)
    except BagError as error:
        log.warning("%s: %s", path, error)
        report.bad_input("damaged bag")
