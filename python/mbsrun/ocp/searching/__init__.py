"""Searches of many solves: finer grids, many starts, studies, in one process or in many."""
