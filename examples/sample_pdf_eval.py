"""Fit a method, and use its three queries to estimate an albedo; no renderer takes part."""

from __future__ import annotations

import harness

budget = harness.Budget(steps=200, conditions=64, directions=32, resolution=32, pool=512)
sampler = harness.fit("improved-baseline", "brushed-metal", budget)
print(f"fitted {sampler.report.parameters} parameters in {sampler.report.steps} steps")

# One place and one given direction, many times over.
condition = sampler.conditions(1, seed=7).expand(100_000, -1)
wo, pdf = sampler.sample(condition, seed=1)
again = sampler.pdf(condition, wo)
print(f"sample's and pdf's densities differ by {(again / pdf - 1).abs().max():.1e} at most")

# The albedo is the integral of f cos over solid angle, which is that of f over the disk.
estimates = sampler.eval(condition, wo) / pdf[:, None]
mean, error = estimates.mean(0), estimates.std(0) / len(estimates) ** 0.5
print("albedo:", ", ".join(f"{m:.4f} +- {2 * e:.4f}" for m, e in zip(mean, error, strict=True)))
