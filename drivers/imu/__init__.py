"""A unit as a stream of decoded samples on the bench's clock."""

from drivers.imu.samples import Imu, ImuIdentity, SampleBlock

__all__ = ["Imu", "ImuIdentity", "SampleBlock"]
