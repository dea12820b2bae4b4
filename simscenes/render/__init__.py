"""Radiance with its variance, and the geometry behind every pixel, rendered with Mitsuba into a set folder."""

from simscenes.render.job import render_set as render_set
