"""Measured data: sensors, conditions and collects of a campaign; reading and writing its folder."""

from hil.campaign.data import BoolArray, Campaign, Collects, Conditions, FloatArray, IntArray, Sensor, Series, TextArray

__all__ = ["BoolArray", "Campaign", "Collects", "Conditions", "FloatArray", "IntArray", "Sensor", "Series", "TextArray"]
