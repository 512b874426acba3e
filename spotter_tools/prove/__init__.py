"""The proving ground: test drives in closed loop and simulated time.

    from spotter_tools.prove import run
    from spotter_tools.prove.dangers import car_stopped

    print(run(car_stopped(2.0)))

``case``: what a case and an outcome are. ``places``, ``dangers``, ``innocents``, ``catalogue``: the cases.
``braked``, ``senses``, ``detector``, ``deciders``, ``plain_rules``, ``loop``: one drive. ``yardstick``, ``judge``: what
came of it. ``ground``: all of them, over the cores. ``table``, ``picture``: for people.
"""

from __future__ import annotations

from spotter_tools.prove.case import Case, Outcome


def run(case: Case, decider: str = "spotter") -> Outcome:
    """Drive a case and say what came of it; the same case gives the same outcome.

    Args:
        decider: ``spotter``, or ``article`` for the article's rules on the same sensors.
    """
    from spotter_tools.prove.judge import judge
    from spotter_tools.prove.loop import drive
    from spotter_tools.prove.yardstick import measure

    return judge(drive(case, decider), measure(case))


__all__ = ["Case", "Outcome", "run"]
