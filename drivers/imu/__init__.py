"""A unit as a stream of decoded samples on the bench's clock."""

from drivers.imu.samples import ImuIdentity, SampleBlock

__all__ = ["ImuIdentity", "SampleBlock"]
