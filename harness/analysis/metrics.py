"""What every number of ``load_results`` is: its unit and its meaning, by measure.

A ``*`` in a metric's name stands for what the measure's own names go on with: an effect, a level of
detail, a hard case. Of numbers of a render, a *sample* is one of one pixel.
"""

from __future__ import annotations

from dataclasses import dataclass
from fnmatch import fnmatchcase


@dataclass(frozen=True)
class Metric:
    """``unit`` "1" is a pure number; radiance^2 is the square of a pixel's luminance."""

    measure: str
    name: str
    unit: str
    about: str


_TEXT = """
constant-light variance radiance^2 | of one sample, in constant light, by quadrature
constant-light relative-variance 1 | the same over the mean squared luminance
constant-light footprint-variance radiance^2 | the part that comes from within a pixel's footprint
constant-light footprint-share 1 | that part over the whole
constant-light tail-resolved 1 | 0 where the integrand's tail leaves the number a lower bound
convergence mse-last radiance^2 | mean squared error of the render with most samples
convergence slope 1 | of log squared error over log samples; -1 for independent samples
cost batch 1 | rows in the batch that samples and pdf queries were timed on
cost seconds-per-million-samples s | of the method's sample alone
cost seconds-per-million-pdf s | of its pdf alone
cost sample-time-ratio 1 | seconds of sample over the baseline's
cost pdf-time-ratio 1 | seconds of pdf over the baseline's
cost seconds-per-spp s | of a render, for one sample in every pixel
cost time-ratio 1 | the same over the baseline's
cost *-share 1 | of a render's time: sampling (sample and pdf), material (its evaluation), rest
cost *-seconds-per-spp s | the same in seconds
cost metering-overhead 1 | what taking the render apart adds to its time
cost measuring-overhead 1 | time of the measuring beside that which is measured
cost rays 1/spp | rays for one sample in every pixel
cost shading-points 1/spp | hits of the material for one sample in every pixel
cost *-calls 1/spp | calls of sample, pdf or eval
cost *-rows 1/spp | active rows of those calls
cost fit-seconds s | of the fit, as it recorded them
cost fit-*-seconds s | of its parts: data, optimise, bake
cost load-seconds s | from the file of the state to a ready method
cost compile-seconds s | first call less a later one, with no compiled kernel kept
cost size-bytes B | of the state's file
cost peak-bytes B | of memory, of one sampling call
cost disturbed 1 | 1 where an interval of a time stayed wider than the tolerance
effects seconds-per-spp s | of the scene as it is, for one sample in every pixel
effects noise 1 | relative mean squared difference of two images with half of the samples each
effects flip-noise 1 | FLIP of those two
effects tolerance 1 | the setting, root of a relative mean squared error
effects *.seconds s | that the effect adds to one sample in every pixel
effects *.relmse 1 | squared difference without the effect over the mean square, free of noise
effects *.flip 1 | FLIP between the images with and without it
effects *.gain 1 | variance x seconds without light sampling over that with it
effects *.verdict 1 | 0 negligible, 1 needed, 2 missing in the scene, 3 not needed by it
effects *.unclear 1 | 1 where noise leaves the verdict open
effects *.* 1/sample | rays, evaluations and so on that the effect adds
equal-spp variance radiance^2 | of one sample, mean over pixels that show nothing but the material
equal-spp relative-variance 1 | the same over the mean squared luminance
equal-spp spp 1 | samples in each pixel, of all batches
equal-spp bias 1 | relative difference of the image's mean to the reference's
equal-spp bias-error 1 | standard error of that difference
equal-spp bias-detectable 1 | least relative error of energy that the test finds with 95 % power
equal-spp bias-power-reached 1 | 1 where that is what the setting detect asks for
equal-spp tail-resolved 1 | 0 where the tail of the samples leaves the variance a lower bound
equal-spp tail-index 1 | shape k of the generalised Pareto tail of the samples; no mean from 1 on
equal-spp bias-z 1 | the same in standard errors
equal-spp bias-p 1 | p-value of the image being the reference's
equal-spp first-bias-p 1 | that of the first render, which decides whether there is a longer one
equal-time seconds-per-spp s | of a render, for one sample in every pixel
equal-time samples-per-second 1/s | samples of a pixel
equal-time time-ratio 1 | seconds over the baseline's, of the same rounds
equal-time deadline-seconds s | the setting
equal-time achieved-seconds s | time of the render that was to take that long
equal-time deadline-miss 1 | the latter over the former, less one
equal-time deadline-missed 1 | 1 where that is more than half of the setting agreement
equal-time spp-achieved 1 | samples in each pixel by the deadline
equal-time mse-at-deadline radiance^2 | expected squared error of a pixel at the deadline
equal-time speedup-equal-time 1 | variance x seconds of the baseline over that of the method
equal-time speedup-equal-spp 1 | variance of the baseline over that of the method
equal-time disturbed 1 | 1 where an interval of a time stayed wider than the tolerance
fit fit-seconds s | of the whole fit
fit data-seconds s | of tabulating targets
fit optimise-seconds s | of the optimisation
fit bake-seconds s | of turning what was fitted into tables
fit cpu-seconds s | of processor time in the whole fit, all threads and child processes (on a CPU)
fit disturbed 1 | 1 where the fit took over 1.1 times its processor time: the machine was busy
fit load-seconds s | from the state in memory to the first sample of a new method
fit parameters 1 | numbers that were fitted
fit size-bytes B | of the state
fit steps 1 | optimiser steps, of a fit that was told a time or a share that moves
fit kl-moved 1 | share that KL still moved by in the last doubling of the steps
fit final-loss 1 | of the method's own loss, which is no other's
image-checks *-z 1 | difference of two images in standard errors
image-checks *-p 1 | p-value of their having one mean
image-checks *-variance 1 | variances: MIS over BSDF samples, a wrong density over the right one
image-checks p 1 | least p-value after Holm's correction
image-checks spp 1 | samples in each pixel
image-checks furnace 1 | relative difference to the reference, in constant light
image-checks reference 1 | relative difference to the reference, by BSDF samples alone
image-checks mis 1 | relative difference of MIS to BSDF samples alone
image-checks mis-reference 1 | relative difference of MIS to the reference
image-checks tripled 1 | relative difference of MIS told three times the density
image-checks tilted 1 | relative difference of MIS told exp(2x) times the density
importance-maps binned-error-* 1 | probability in wrong cells after bilinear interpolation
importance-maps gradient-mean-* 1 | mean norm of the map's derivative
importance-maps gradient-p99-* 1 | its 99th percentile
importance-maps cost-* 1 | mean squared distance from the scaled grid
importance-maps evenness-* 1 | chi-square of the map's points per degree of freedom
levels mse-* 1 | squared error to the path-traced truth at a level of detail, less its noise
levels flip-* 1 | FLIP to the truth at a level
levels ssim-* 1 | structural similarity to the truth at a level
levels network-parameters 1 | numbers of the decoder and the offset network
levels texture-numbers 1 | numbers of the textures
levels texture-channels 1 | channels of the textures
patches macro-error 1 | squared difference of blocks' means, over the truth's square, less noise
patches noise 1 | variance of one sample of a pixel over the mean square of the truth
patches same-noise-time-ratio 1 | path-traced geometry's time over the material's, to one noise
patches seconds-per-spp s | of a render of the material
patches size-bytes B | of the tensors as stored
patches truth-noise 1 | noise of path-traced geometry
patches truth-seconds-per-spp s | of a render of the geometry
patches truth-size-bytes B | of the triangles of one tile
pdf kl nats | Kullback-Leibler divergence of the target from the density
pdf chi2 1 | chi-square divergence: relative variance in constant light
pdf kl-resolved 1 | 0 where the tail over conditions leaves kl a lower bound
pdf chi2-resolved 1 | the same of chi2
pdf chi2-median 1 | its median over conditions
pdf mse 1 | squared difference of the densities over the disk
pdf lost-share 1 | share of the target where the density is zero
pdf invalid-share 1 | share of samples off the disk
pdf black-conditions 1 | conditions at which the material reflects nothing, which are left out
pdf negative-share 1 | share of the target where the material's data are negative
pictures spp-achieved 1 | samples in each pixel by the deadline
pictures achieved-seconds s | time of the render that was to take that long
pictures relative-mse 1 | expected squared error of a pixel over the mean squared luminance
sample-weights bias 1 | mean over conditions of the mean weight over the albedo, less one
sample-weights bias-rms 1 | root mean square of that, free of noise
sample-weights biased-share 1 | conditions that differ by more than three standard errors
sample-weights relative-variance 1 | of one weight, over the squared albedo; mean over conditions
sample-weights relative-variance-median 1 | its median
sample-weights noise-free-variance 1 | the same if f were known; mean over conditions
sample-weights noise-free-variance-median 1 | its median
slices kl-mean nats | Kullback-Leibler divergence, mean over the slices
stability */efficiency efficiency | effective share of samples, of a hard case's worst condition
stability */lost share | share of the target where the density is zero
stability */tail-index 1 | of the weights' tail; below 2 the variance is infinite
stability */largest-weight x_mean | largest weight over the mean
stability */invalid 1 | share of samples off the disk
stability * verdict | of a hard case: 0 pass, 1 degraded, 2 fail
stages stage-1-seconds s | of offset and lookup of a million rows
stages stage-2-seconds s | of the decoder, of a million rows
stages bare-seconds s | of a torch network of the decoder's size
stages stage-2-ratio 1 | the decoder's over that
throughput batch 1 | rows in the batch
throughput samples-per-second 1/s | rows of sample
throughput pdf-queries-per-second 1/s | rows of pdf
throughput sample-time-ratio 1 | seconds of sample over the baseline's
throughput pdf-time-ratio 1 | seconds of pdf over the baseline's
throughput disturbed 1 | 1 where an interval of a time stayed wider than the tolerance
walk-slices kl-* nats | of the walks' directions to the learned density, at an angle; 0 the normal
walk-slices albedo-ratio-* 1 | albedo over that of the walks, at an angle; 0 the normal
walks albedo-ratio-* 1 | albedo over that of the walks, at an angle; 0 the most grazing
walks albedo-within 1 | share of directions and channels whose albedo is within 3 % of the walks'
walks albedo-noise 1 | 95th percentile of the relative error of the walks' own albedo
walks shape-error 1 | squared error of f in cells over its square, less the walks' noise
walks reciprocity-error 1 | mean difference of f from one side and from the other, over its mean
walks size-bytes B | of the tensors as stored
"""


def _read(line: str) -> Metric:
    head, _, about = line.partition(" | ")
    measure, name, unit = head.split()
    return Metric(measure, name, unit.replace("_", " "), about)


METRICS = [_read(line) for line in _TEXT.strip().splitlines()]


def of_measure(measure: str) -> list[Metric]:
    """The metrics of a measure; empty for one that is not part of the harness."""
    return [metric for metric in METRICS if metric.measure == measure]


def find(measure: str, name: str) -> Metric | None:
    """The metric of that name: the entry that is it, or the first that stands for it."""
    known = of_measure(measure)
    exact = (metric for metric in known if metric.name == name)
    return next(exact, next((m for m in known if fnmatchcase(name, m.name)), None))
