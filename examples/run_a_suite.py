"""A suite as a dictionary, its numbers as a table, and a sampler that it fitted taken up again."""

from __future__ import annotations

import harness

suite = {
    "name": "clearcoat",
    "materials": [
        {
            "name": "clearcoat",
            "type": "mitsuba",
            "bsdf": {"type": "principled", "roughness": 0.4, "clearcoat": 1.0},
        }
    ],
    "methods": ["cosine", "histogram"],
    "scenes": ["uniform-sphere"],
    "measures": [
        {"name": "pdf", "conditions": 32, "resolution": 64, "samples": 64},
        {"name": "equal-spp", "batches": 6, "spp": 8, "reference_spp": 64},
    ],
    "resolution": 24,
    "budget": {"steps": 100, "conditions": 64, "directions": 32, "resolution": 32, "pool": 256},
}
numbers = harness.run(suite, "clearcoat-results")
shown = numbers[numbers.metric.isin(["kl", "variance"])]
print(shown.pivot_table(index="method", columns="metric", values="value"))

sampler = harness.load_sampler("clearcoat-results", "clearcoat", "histogram")
wo, pdf = sampler.sample(sampler.conditions(5))
print(wo, pdf)
