"""One simulated world and what each sensor measures of it, down to the bytes on the wire.

Everything is a pure function of (scenario, time): no process, no clock, no file. From the ground up:

- ``motion``, ``solids``, ``bodies``, ``scene``: how things move, what rays hit, people and vehicles, what stands still.
- ``model``, ``crossing``, ``roadside``, ``world``: actors and scenarios; the demonstration; random scenes; the entry.
- ``ld06``, ``bgt60``, ``camera`` (with ``view``), ``lidar128``: bytes, chirps, pictures and scans of the same bodies.
- ``raycast``: rays in plain numpy; ``truth``: what every sensor ought to say.
"""
