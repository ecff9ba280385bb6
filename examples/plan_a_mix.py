# SPDX-License-Identifier: Apache-2.0
"""Order the picks of a mix so that fingers are swapped as seldom as possible."""

from softgrip_cell.catalogue_file import read_catalogue
from softgrip_cell.outcomes import estimate
from softgrip_cell.planner import Order, Plan, plan_mix


def main() -> Plan:
    """Plan eggs, grapes and tomatoes on the vine for a cell with power fingers."""
    catalogue = read_catalogue()
    orders = [Order("grape", 20), Order("egg", 10), Order("grape", 5), Order("tomato_vine", 4)]
    estimates = {
        product.id: {name: estimate(product.marks.get(name)) for name in catalogue.finger_sets}
        for product in catalogue.products.values()
    }
    plan = plan_mix(orders, estimates, tuple(catalogue.finger_sets), mounted_set="power")
    for step in plan.steps:
        swap = "swap, then " if step.swap_before else ""
        print(f"{swap}{step.order.quantity} x {step.order.product} with {step.finger_set} fingers")
    print(f"{plan.swaps} swap(s), {plan.predicted_time_s / 60:.0f} min, expected success {plan.expected_success:.0%}")
    return plan


if __name__ == "__main__":
    main()
