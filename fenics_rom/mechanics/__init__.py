"""Laws that full order and runtime share: contact, obstacles, hyperelasticity, loads, the energy account."""
