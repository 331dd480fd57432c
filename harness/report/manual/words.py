"""Meaning and unit of every key of a suite and of every setting of a measure."""

from __future__ import annotations

KEYS = {
    "Suite": {
        "name": "names the results folder",
        "title": "headline of tables and page",
        "materials": "a name, or a mapping (own-scenes.md): `type`, and what that type takes",
        "methods": "a name, `file.py:Class`, or a mapping with the keys below",
        "scenes": "a name or a mapping (own-scenes.md); needed by measures that render",
        "measures": "a name, or a mapping with the settings below",
        "seeds": "of fits, samples and renders; every trial once for each",
        "baseline": "label of the method that times and speed-ups are relative to; by default"
        " `improved-baseline` if the suite has it, else the first",
        "resolution": "pixels across of all renders, where a measure does not say",
        "parameters": "values for `$name` in the suite's XML files",
        "budget": "of all fits, with the keys below",
        "report": "tables and figures to be made, with the keys below",
        "profiles": "by name: sizes of the suite, with the keys below; `quick` is the default, and"
        " `fast` is there without being written",
    },
    "MethodSpec": {
        "name": "of `harness list methods`, or `path/to/file.py:Class`",
        "label": "what tables call it; by default its name and parameters",
        "params": "keyword arguments of its constructor",
        "budget": "of its fits, before that of the suite",
        "sweep": "`knobs`, or lists of values by knob: one variant more for each value",
    },
    "BudgetSpec": {
        "steps": "optimiser steps",
        "conditions": "conditions in a batch",
        "directions": "directions for each of them",
        "resolution": "cells a side of the tabulated targets on the disk",
        "pool": "conditions whose targets are tabulated",
        "max_seconds": "s; a fit that takes longer ends as `timeout`",
    },
    "ReportSpec": {
        "tables": "names below; by default all that have numbers",
        "figures": "names below; by default all that have numbers",
    },
    "Profile": {
        "materials": "only these",
        "methods": "only these, by label",
        "scenes": "only these",
        "seeds": "in place of the suite's",
        "resolution": "in place of the suite's",
        "budget": "before that of the suite",
        "measures": "by measure: settings before those of the suite",
        "override": "by method: `params` and `budget` before the method's own",
    },
}
"""By schema: what each key means."""

SETTINGS = {
    "agreement": ("1", "times achieved within a deadline may differ by this share"),
    "batch": ("rows", "of a timed call"),
    "batches": ("renders", "independent ones, over which intervals are"),
    "bins": ("cells a side", "of the raster that the interpolation error is counted in"),
    "cases": ("names", "of hard cases, `harness list cases`; null: all"),
    "conditions": ("conditions", "held out from fitting"),
    "count": ("conditions", "whose slices are made"),
    "detect": ("1", "relative error of the energy that a test is to find with 95 % power"),
    "deadline": ("s", "of the render that is to take so long"),
    "grid": ("cells a side", "of the raster of a slice"),
    "least_seconds": ("s", "the slices of a round take together at least"),
    "levels": ("levels", "of samples (1, 2, 4, ... per pixel) or of detail"),
    "longest": ("1", "times as many batches and reference samples at most; 1: no more"),
    "max_processes": ("processes", "while an interval is too wide; null: as many as `processes`"),
    "max_rounds": ("rounds", "while an interval is too wide; null: twice `rounds`, 0: no more"),
    "max_seconds": ("s", "after which no more is begun"),
    "patience": ("s", "a method that would need longer is not begun: `timeout`"),
    "pixels": ("pixels", "that show the material, at most; chosen evenly"),
    "points": ("directions", "drawn at each of two points of a pixel; a multiple of eight"),
    "power_seconds": ("s", "of further batches at most, so that a bias is found"),
    "processes": ("processes", "in which the timing is repeated"),
    "reference_seconds": ("s", "of the reference at most"),
    "reference_spp": ("samples a pixel", "of the reference image"),
    "repeats": ("renders", "of each level"),
    "resolution": ("pixels across", "of a render; in `pdf` cells a side of the disk"),
    "resolutions": ("cells a side", "of the maps"),
    "rounds": ("rounds", "of the timing, in which the methods alternate"),
    "rows": ("rows", "of a timed call, exactly; null: see `batch`"),
    "samples": ("samples", "of a condition; in `levels` paths a pixel of the truth"),
    "shown": ("slices", "that are kept as images"),
    "side": ("points a side", "of the raster that the interpolation error is estimated from"),
    "size": ("pixels a side", "of a picture"),
    "slice_resolution": ("cells a side", "of the slices that maps are made of"),
    "slice_seconds": ("s", "of rendering for a method and round"),
    "slices": ("slices", "of a round, each beside one of the baseline's"),
    "spp": ("samples a pixel", "of a render; null: as many as fill `slice_seconds`"),
    "stable": ("1", "two calls that differ by no more than this share end the warm-up"),
    "starts": ("processes", "that are started cold; 0: none"),
    "tolerance": ("1", "width of an interval over its value that is narrow enough; in `effects`"
                  " root of the relative mean squared error that does not matter"),
    "views": ("pictures", "of each level of detail"),
    "warm_up": ("s", "of warming up at most"),
}  # fmt: skip
"""By name: unit and meaning."""
