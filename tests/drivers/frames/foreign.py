"""Frames that nobody here made, by the description that reads them: bytes, where they stand, and what they hold.

A frame is written in hexadecimal digits, a line of text as it is. Numbers are those that the source prints, or, where
it prints none, what its maker's table makes of the bytes by hand.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

RAD_PER_S = 3600 * 57.29577951308232  # deg/hr
GRAVITY = 9.80665  # m/s²


@dataclass(frozen=True)
class Foreign:
    """Bytes of a source: `frame` is the type that they are, `values` its fields; `settings` those of the unit."""

    source: str
    sent: bytes
    frame: str
    values: dict[str, float]
    settings: dict[str, Any] = field(default_factory=dict)
    ok: int = 1


def _line(text: str) -> bytes:
    return text.encode() + b"\r\n"


_HI91 = (
    "5AA54C0014BB9108152309A2C44708151C00CCE861BE9A35563E65EA723F31D07CBD75DDC5BB6BD724BC8988FC4001006A41AB2A70C2"
    "96D45041ED03434141F4F4C2CCCAF8BE736A19BEF0001C3D8D375C3F"
)
_HI91_OF_THE_MANUAL = (
    "5AA54C006C519100A03B01A80297BDBB04009CA0653EA226453F5CE7303FE2D45AC2E59DA0C1EB23EEC278779941ABAAD1C1AB2A0AC2"
    "8DE142428F1DA8C11E0C36C2E6E55A3FC1949E3EB8C09EBEBEDF8DBE"
)
_HI92 = "5AA53000E3A49223231C7C1161FF2323000001000000EBFE7B00B607CD0370FCA3FC561F0000CF0D0000C4070000F0262701C002C200"
_HI81 = (
    "5AA56800700481000201150943C83E02000083003C0036018FFBE80431047C02B2F9BFFE607900102418071C0A1BEB749A0E8A0E2E182020"
    "3B10190465F1996A5D453161CE1706D100000C07011C000000B9FC01000002000000C6FF0801E7FF7F1241004E61CE1704CF00000000"
)
_RAWIMUSX = (
    "AA441328B6059C0678B9E21C000B9C060B9755A832941D4103158000EBD09102A687F3FF38EAFCFF66B7FCFF1C5FFFFF59D9FFFF475FAFBA"
)
_TURN, _PULL = 100 * RAD_PER_S * 2**-33, 100 * 2**-29 / GRAVITY  # counts of an HG4930 at 100 Hz

FROM_TABLES = {"sbg", "adis16470", "epson-g3xx-32", "csv-logger"}
"""Of these, no bytes are public that their makers' units sent."""

FOREIGN: dict[str, list[Foreign]] = {
    "hipnuc": [
        Foreign(
            "hipnuc/products examples/python/parsers/hipnuc_serial_parser.py (Apache-2.0); values printed by its users",
            bytes.fromhex(_HI91),
            "HI91",
            {"temperature": 35, "system_time": 1840.392, "acc_x": -0.220615, "rpy_yaw": -122.477, "acc_z": 9.305 / 9.8},
        ),
        Foreign(
            "HiPNUC HI14 manual, chapter 6.3",
            bytes.fromhex(_HI91_OF_THE_MANUAL),
            "HI91",
            {"acc_x": 0.224, "acc_y": 0.770, "acc_z": 0.691, "rpy_roll": 48.720, "rpy_pitch": -21.014},
        ),
        Foreign(
            "hipnuc/products, an earlier hipnuc_serial_parser.py",
            bytes.fromhex(_HI92),
            "HI92",
            {"temperature": 28, "gyro_y": 0.001 * RAD_PER_S, "acc_z": 0x07B6 * 0.0048828 / GRAVITY, "rpy_roll": 8.022},
        ),
        Foreign(
            "hipnuc/products examples/python/parsers/hipnuc_serial_parser.py (Apache-2.0)",
            bytes.fromhex(_HI81),
            "HI81",
            {"gyro_x": 0x83 * 0.001 * RAD_PER_S, "acc_y": 0x04E8 * 0.0048828 / GRAVITY},
        ),
    ],
    "openimu": [
        Foreign(
            "Aceinna/python-openimu tests/mocker/devices/z1.raw (Apache-2.0), its first two packets",
            bytes.fromhex(
                "55557a31288ce0670122bd9fbeba65d63eacfd1cc1df89c03f4bb0fc3f77334d407cf6e93dc412c3bbca7f0b3eb77f"
                "55557a312870076801d5978dbe6518cf3ecf421cc13f329b3ff41df73f87f64c405c23ea3d7ff8bfbb146f0b3e8b91"
            ),
            "z1",
            {"time": 23.584908, "acc_z": -9.811931610 / GRAVITY, "gyro_x": 3600 * 1.504207492, "mag_z": 0.13622966},
            ok=2,
        ),
        Foreign(
            "Aceinna/python-openimu tests/mocker/devices/s1.raw (Apache-2.0), its first two packets",
            bytes.fromhex(
                "5555733134d6f73f0152b81e855b7ad4402faa45c0a6f137bf90d013c11c3b82c06e70e240960f0bc1889b503e076adb3d14c8273d"
                "0018f641e9ba5555733134e0f73f018fc2f5285c7ad440df8444c08a3c5bbf5a1f14c12254f0c0fa7a3e406101f4c0675f503e903d"
                "dc3d1ab3273d0018f6417861"
            ),
            "s1",
            {"milliseconds": 20969.430, "seconds": 20969.43, "acc_z": -9.2384186 / GRAVITY, "temperature": 30.761719},
            ok=2,
        ),
    ],
    "novatel": [
        Foreign(
            "novatel/novatel_edie python/test/test_framer.py (MIT); its ASCII form is below",
            bytes.fromhex(_RAWIMUSX),
            "RAWIMUSX",
            {
                "milliseconds": 484620.664,
                "imu_seconds": 484620.664389,
                "acc_z": 43110635 * _PULL,
                "gyro_x": -9895 * _TURN,
            },
        ),
        Foreign(
            "a receiver's RAWIMUSX in a driver's test (holo, novatel)",
            bytes.fromhex(
                "AA441328B605290818677A01002029083D26F7E0BE37D84000000B0FAF0605006208000030E8FFFF6F0000003E00000054FFFFFF8BE5610C"
            ),
            "RAWIMUSX",
            {"week": 2089, "imu_type": 32, "acc_y": -2146 * _PULL, "gyro_y": -62 * _TURN, "gyro_x": -172 * _TURN},
        ),
    ],
    "novatel-ascii": [
        Foreign(
            "novatel/novatel_edie python/test/test_framer.py (MIT)",
            _line(
                "%RAWIMUSXA,1692,484620.664;00,11,1692,484620.664389000,00801503,43110635,-817242,-202184,-215194,-41188,"
                "-9895*a5db8c7b"
            ),
            "RAWIMUSX",
            {"imu_status": 0x00801503, "acc_z": 43110635 * _PULL, "gyro_y": 41188 * _TURN, "gyro_x": -9895 * _TURN},
        ),
        Foreign(
            "a CNS-5000's line in a public ROS driver",
            _line("%RAWIMUSA,1815,407772.000;1815,407771.985103333,00000077,63811,-6290,6253,7,-31,14*2d2a4cff"),
            "RAWIMUS",
            {"seconds": 407771.985103333, "imu_status": 0x77, "acc_x": 6253 * _PULL, "gyro_y": 31 * _TURN},
        ),
        Foreign(
            "a receiver's line in a public driver's test",
            _line(
                "#RAWIMUA,COM3,0,72.0,FINESTEERING,2038,117867.800,1a008000,fa9a,14968;2038,117867.792005000,f7f7fe00,"
                "-325882330,-39071383,104462335,-240437176,7815616,-7423919*a02e612f"
            ),
            "RAWIMU",
            {"reserved": 0xFA9A, "software": 14968, "seconds": 117867.792005, "acc_x": 104462335 * _PULL},
        ),
    ],
    "vectornav-ascii": [
        Foreign(
            "a VN-200's line in a MATLAB course's reader",
            _line(
                "$VNIMU,-00.0350,+00.4222,-00.6643,-00.015,+00.019,+09.948,+00.002066,-00.008442,-00.044656,+20.7,"
                "+084.322*66"
            ),
            "VNIMU",
            {"mag_y": 0.4222, "acc_z": 9.948 / GRAVITY, "gyro_z": -0.044656 * RAD_PER_S, "temperature": 20.7},
        ),
        Foreign(
            "a VN-200's line in a driver's read-me",
            _line(
                "$VNINS,224159.474991,2048,8085,-149.042,+013.639,+010.915,+40.09623362,-088.20139124,+00204.179,"
                "+000.023,+000.007,-000.248,20.5,02.5,0.20*6F"
            ),
            "VNINS",
            {"time": 224159.474991, "status": 0x8085, "ypr_roll": 10.915, "position_longitude": -88.20139124},
        ),
    ],
    "witmotion": [
        Foreign(
            "a HWT905's nine frames in a read-me (bsli-payload-project)",
            bytes.fromhex(
                "555000000000052895016855510c0093026d08b7077a5552000000000000b707655553040ce1ff6ff2cc460b5554acf93b0b86e7"
                "0000015555ed0fa30a5708fb06b355560000000000000000ab5559238384ed5f03f1142c555a0000000000000000af"
            ),
            "sample",
            {"acc_x": 12 / 2048, "acc_y": 659 / 2048, "acc_z": 2157 / 2048, "temperature": 19.75, "gyro_x": 0.0},
            ok=9,
        ),
        Foreign(
            "a JY61P's frames in a firmware's comments",
            bytes.fromhex("55519FFDE8FFA507350B155552000000000000350BE7555369217DF8E8C482461B55540000000000000000A9"),
            "sample",
            {"acc_x": -609 / 2048, "acc_z": 1957 / 2048, "temperature": 28.69},
            ok=4,
        ),
    ],
    "mavlink": [
        Foreign(
            "code-lever/mavlink-log spec/messages/raw_imu_spec.rb (MIT)",
            bytes.fromhex("FE1AA237011B4018A32700000000C6027F0155F4EE17F017B418000000000000DD85"),
            "raw_imu_1",
            {"time": 665.0, "acc_x": 0.710, "acc_y": 0.383, "acc_z": -2.987, "gyro_z": 6.324 * RAD_PER_S},
        ),
    ],
}
