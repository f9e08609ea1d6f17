"""Mitsuba's path replay for single pixels of a picture, in Mitsuba's environment: it has whole pictures and windows."""

from __future__ import annotations

from functools import cache

NAME = "prb_pixels"


@cache
def register(mi, dr) -> None:
    """Once, the integrator `NAME`: `prb` that follows paths from the `chosen` pixels and leaves the others black."""

    class PixelsIntegrator(mi.ad.integrators.prb.PRBIntegrator):
        chosen = None  # rows and columns, UInt32

        def prepare(self, sensor, seed=0, spp=0, aovs=()):
            sampler = sensor.sampler().clone()
            if spp:
                sampler.set_sample_count(spp)
            spp = sampler.sample_count()
            sampler.set_samples_per_wavefront(spp)
            sampler.seed(seed, len(self.chosen[0]) * spp)
            sensor.film().prepare(list(aovs))
            return sampler, spp

        def sample_rays(self, scene, sensor, sampler):
            spp = sampler.sample_count()
            path = dr.arange(mi.UInt32, len(self.chosen[0]) * spp) // dr.opaque(mi.UInt32, spp)
            row, column = (dr.gather(mi.UInt32, numbers, path) for numbers in self.chosen)
            corner = mi.Vector2f(column, row)
            place = (corner + sampler.next_2d()) / mi.ScalarVector2f(sensor.film().size())
            with dr.resume_grad():
                ray, weight = sensor.sample_ray_differential(
                    time=sensor.shutter_open(), sample1=0, sample2=place, sample3=mi.Vector2f(0)
                )
            return ray, weight, corner  # of a box filter: all of a sample goes to its own pixel

    mi.register_integrator(NAME, PixelsIntegrator)
