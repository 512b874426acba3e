"""Learning a site from its own tracks, without labels: ``spotter-infra-lidar adapt``. See docs/adapt.md."""
