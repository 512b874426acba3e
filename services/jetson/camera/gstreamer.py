"""The command lines of the capture child, and what to tell a person when it is lost. No process is started here."""

from __future__ import annotations

from common.config import ConfigError
from common.source_url import SourceUrl
from services.jetson.camera.config import CaptureConfig

_RAW_BGR = "video/x-raw,format=BGR,width={width},height={height}"
_GSTREAMER = {
    "csi": (
        *("gst-launch-1.0", "-q", "nvarguscamerasrc", "sensor-id={device}", "!"),
        "video/x-raw(memory:NVMM),width={sensor_width},height={sensor_height},framerate={sensor_rate}/1",
        *("!", "nvvidconv", "!", "video/x-raw,format=BGRx,width={width},height={height}"),
        *("!", "videoconvert", "!", _RAW_BGR, "!", "fdsink", "fd=1", "sync=false"),
    ),
    "v4l2": (
        *("gst-launch-1.0", "-q", "v4l2src", "device={device}", "!", "decodebin"),
        *("!", "aspectratiocrop", "aspect-ratio={width}/{height}"),  # square pixels, whatever mode the camera has
        *("!", "videoscale", "!", "videoconvert", "!", _RAW_BGR, "!", "fdsink", "fd=1", "sync=false"),
    ),
}


def picture_size(url: SourceUrl, config: CaptureConfig) -> tuple[int, int]:
    """Width and height of the child's pictures: the sensor's shape within the configured size, with square pixels.

    A command of one's own gives the configured size, and so does v4l2:, which cuts the camera's picture to that shape.
    """
    if url.scheme != "csi" or config.csi_command:
        return config.width_px, config.height_px
    scale = min(config.width_px / config.sensor_width_px, config.height_px / config.sensor_height_px)
    return max(round(config.sensor_width_px * scale / 4) * 4, 4), max(round(config.sensor_height_px * scale / 2) * 2, 2)


def command(url: SourceUrl, config: CaptureConfig) -> list[str]:
    """The child's command line, from the configuration or the built-in GStreamer pipeline.

    Raises:
        ConfigError: a placeholder that is not known.
    """
    template = {"csi": config.csi_command, "v4l2": config.v4l2_command}[url.scheme] or _GSTREAMER[url.scheme]
    width_px, height_px = picture_size(url, config)
    values = {
        "device": url.target if url.scheme == "csi" else device_path(url),
        "width": width_px,
        "height": height_px,
        "rate": config.rate_hz,
        "sensor_width": config.sensor_width_px,
        "sensor_height": config.sensor_height_px,
        "sensor_rate": config.sensor_rate_hz,
    }
    try:
        return [part.format_map(values) for part in template]
    except (KeyError, ValueError, IndexError) as error:
        known = ", ".join(f"{{{name}}}" for name in values)
        raise ConfigError(f"[capture] {url.scheme}_command: {error} is no placeholder; known: {known}") from None


def advice(url: SourceUrl) -> str:
    """What a person may do about a camera that is lost."""
    if url.scheme == "csi":
        return (
            "the capture is being restarted; if it stays away, restart the camera daemon: "
            "sudo systemctl restart nvargus-daemon, then check the ribbon cable"
        )
    return f"the capture is being restarted; if it stays away, unplug and replug {device_path(url)}"


def device_path(url: SourceUrl) -> str:
    """``v4l2:0`` is short for ``v4l2:/dev/video0``."""
    return f"/dev/video{url.target}" if url.target.isdigit() else url.target
