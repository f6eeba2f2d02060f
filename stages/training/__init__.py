"""The one optimisation loop, its objectives, density control and schedules."""
