"""Gymnasium environments of a lattice worm made of Cosserat rods."""
