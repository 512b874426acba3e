"""One simulated world and what each sensor measures of it, down to the bytes on the wire.

Everything is a pure function of (scenario, time): no process, no file, and no clock but that of
``scenario_clock``. From the ground up:

- ``motion``, ``solids``, ``bodies``, ``scene``: how things move, what rays hit, people and vehicles, what stands still.
- ``vehicle``, ``tour``: our own vehicle, its sensors' places, and how it drives.
- ``model``, ``crossing``, ``roadside``, ``world``: actors and scenarios; the demonstration; random scenes; the entry.
- ``yard`` (with ``ramp``), ``emergency``: what the vehicle drives through, with nothing in its way and with a lot.
- ``ld06``, ``bgt60``, ``camera`` (with ``view``, ``backdrop``), ``lidar128``: bytes, chirps, pictures and scans of the
  same bodies; ``odometry``: how fast the vehicle says that it drives.
- ``raycast``: rays in plain numpy; ``truth``: what every sensor ought to say; ``contact``: gaps and
  contacts of the vehicle's outline.
"""
