"""Compile the roadside lidar's kernels, and the simulator's, for this processor: once, so that no start waits for it.

Numba keeps the result beside the sources; a changed file is compiled again when it is first used.
"""

from __future__ import annotations

from common.sim import lidar128
from services.infra_lidar.config import InfraLidarConfig
from services.infra_lidar.pipeline import InfraLidarPipeline
from services.infra_lidar.warm_up import warm_up
from services.infra_lidar.warm_up_parts import PACKET_KERNELS


def main() -> None:
    """Warm up as the service does, and run three frames of the simulator, which has kernels of its own."""
    config = InfraLidarConfig()
    warm_up(config, lambda _: None)
    for decode_nothing in PACKET_KERNELS.values():
        decode_nothing()
    pipeline = InfraLidarPipeline(config)
    for tenth in range(3):
        pipeline.process(tenth * 100_000_000, lidar128.scan("crossing", tenth / 10).xyz)


if __name__ == "__main__":
    main()
