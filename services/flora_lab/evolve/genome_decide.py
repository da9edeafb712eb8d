"""What networks decide, several scenarios of one network side by side: left, right, or no answer.

The decisions are those of each network asked alone, one node after the other, to the bit. A sum goes on in one order,
in which each addition waits for the one before, so that four lanes cost little more than one. And C itself is not
needed: the output node's sigmoid is above 0.5 where what goes into it is above 0. Close to 0, where rounding decides, C
is computed.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from flora_common.arrays import Array
from flora_common.controller_file import LEFT_AT_MOST
from flora_lab.evolve.genome_activate import Networks, activation_value, aggregate
from flora_lab.evolve.neat_genes import ACTIVATION_NUMBERS, AGGREGATION_NUMBERS
from flora_lab.evolve.plant_looks import STEM, TOLD
from flora_lab.simulator.rod import jit

LANES: Final = 4
"""Scenarios of one network that are decided side by side. What comes out does not depend on it."""
NO_DECISION: Final = -1
_SIGMOID: Final = ACTIVATION_NUMBERS["sigmoid"]
_SUM: Final = AGGREGATION_NUMBERS["sum"]
_SIGN_IS_ENOUGH: Final = 1e-6
"""exp(-5e-6) is below 1 by 5e-6, which no rounding makes up for."""
_MIDDLE: Final = 0.5


@jit
def decide(
    networks: Networks, going: Array, count: int, plant: Array, stems: Array, told: Array, slots: Array, decision: Array
) -> None:
    """Ask networks in all scenarios in which an episode goes on.

    One call for all of them, and no slices within: numba counts references at every call and slice, which would take
    longer than the sums.

    Args:
        networks: with one output.
        going: which networks to ask; the first ``count``.
        count: see there.
        plant: row of each episode's plant, or below 0 where it has ended; shape (networks, scenarios).
        stems: scaled inputs by row of the plant, finite and not too large; shape (rows, 20).
        told: the further inputs by scenario; shape (scenarios, 6).
        slots: room for the values of one network, shape (LANES, inputs and nodes), of any finite numbers.
        decision: shape (networks, scenarios), written where an episode goes on: 1 for right, 0 for left, or
            :data:`NO_DECISION`.
    """
    source, weight = networks.source, networks.weight
    scenarios, inputs = len(told), STEM + TOLD
    is_asked = np.zeros(LANES, dtype=np.bool_)
    for first in range(0, scenarios, LANES):
        for lane in range(min(LANES, scenarios - first)):
            for j in range(TOLD):
                slots[lane, STEM + j] = told[first + lane, j]
        for i in range(count):
            g = going[i]
            first_node, end = networks.node_start[g], networks.node_start[g + 1]
            is_any = False
            for lane in range(LANES):
                s = first + lane
                is_asked[lane] = s < scenarios and plant[g, s] >= 0
                if not is_asked[lane]:
                    continue
                is_any, row = True, plant[g, s]
                decision[g, s] = 0
                for j in range(STEM):
                    slots[lane, j] = stems[row, j]
            if not is_any:
                continue
            for n in range(first_node, end):
                start, stop = networks.edge_start[n], networks.edge_start[n + 1]
                bias, response = networks.bias[n], networks.response[n]
                slot = inputs + n - first_node
                if networks.aggregation[n] == _SUM:
                    a = b = c = d = 0.0
                    for e in range(start, stop):
                        at, w = source[e], weight[e]
                        a += slots[0, at] * w
                        b += slots[1, at] * w
                        c += slots[2, at] * w
                        d += slots[3, at] * w
                    slots[0, slot], slots[1, slot] = bias + response * a, bias + response * b
                    slots[2, slot], slots[3, slot] = bias + response * c, bias + response * d
                else:
                    for lane in range(LANES):
                        gathered = aggregate(networks.aggregation[n], slots[lane], source, weight, start, stop)
                        slots[lane, slot] = bias + response * gathered
                kind = networks.activation[n]
                # All nodes lead to the output, so that it is the last one.
                is_output = n == end - 1
                is_sign_enough = is_output and kind == _SIGMOID and LEFT_AT_MOST == _MIDDLE
                for lane in range(LANES):
                    if not is_asked[lane]:
                        continue
                    z = slots[lane, slot]
                    if is_sign_enough and _SIGN_IS_ENOUGH < abs(z) < np.inf:
                        decision[g, first + lane] = z > 0.0
                        continue
                    value = activation_value(kind, z)
                    slots[lane, slot] = value
                    if not (np.isfinite(z) and np.isfinite(value)):
                        decision[g, first + lane] = NO_DECISION
                        is_asked[lane] = False
                    elif is_output:
                        decision[g, first + lane] = value > LEFT_AT_MOST
