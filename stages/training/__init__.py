"""The common optimisation loop, its objectives, density control and schedules."""
