"""Virtual beans with hidden effects, to judge who names them.

The generator knows nothing of the finder: it imports ``flora_common`` and numerics, and no service. One seed gives one
case: reference runs of healthy plants, measured runs of others with an effect, and the truth. Further numbers give
cases of the same world: others are measured, with the same reference runs.

    kernel       the growing stem, compiled
    rod, other   the two forms of physics: laws and typical plants
    scene        one run before it is grown: plant, circumstances, record
    individuals  plants differ, drift and are measured with errors
    schedules    which lamp when
    effects      the catalogue; outside: what is not in it
    record       camera and clock: from the grown stem to the rows of a track
    case         a whole case; writing: its folders

``python -m tests.discovery.worlds --help`` from the repository's root writes one case.
"""
