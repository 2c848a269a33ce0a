"""Gymnasium environments of one worm or of many."""
