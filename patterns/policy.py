"""A learned policy: robots gather, as a small network requests.

CMA-ES (Hansen, "The CMA evolution strategy: a tutorial", arXiv 1604.00772) trained the network with
examples/learning/train_aggregation.py: 300 s of processor time, four Waffle Pis, under protection.
"""

from __future__ import annotations

from swarmd.api import PolicyPattern


class Policy(PolicyPattern):
    """Requests what its network gives for six sectors of robots and six of obstacles."""

    network = """
UEsDBC0AAAAIAAAAIQB90Klx//////////8IABQAc3BlYy5ucHkBABAA+gAAAAAAAACbAAAAAAAAAJvsF+obEMnIUMZQrZ6S
WpxcpG6loF5Taqiuo6Cell9UUpSYF59flJIKEndLzClOBYoXZyQWpAL5GoZGRjqaOgq1CmQDrmqlgsSikmIlq2gIS8lKqSg/
KR8ooqNUnJpckl8ElDPTUQK6Iz1VycpYz7RWB66yODkxD7s6Qz2D2lgdpZzEktSixBwlqzSw05UKUosy81OUrAz0jGoBUEsD
BC0AAAAIAAAAIQB5vE6O//////////8OABQAYWN0aXZhdGlvbi5ucHkBABAAkAAAAAAAAABOAAAAAAAAAJvsF+obEMnIUMZQ
rZ6SWpxcpG6loG4TaqKuo6Cell9UUpSYF59flJIKEndLzClOBYoXZyQWpAL5Gpo6CrUKFAGuEgYGhkQgzgPiDCAGAFBLAwQt
AAAACAAAACEARMsCm///////////DAAUAHdlaWdodF8wLm5weQEAEADgAAAAAAAAAKwAAAAAAAAAm+wX6hsQychQxlCtnpJa
nFykbqWgbpNmoq6joJ6WX1RSlJgXn1+UkgoSd0vMKU4FihdnJBakAvkaRjoKhkaaOgq1CuQCrg2Cm/ZZ1/jaH2GT3Lv+1eT9
PL/D7ANV0+zZTCfaS318ZNemVWC/8MQqu5aHXfsyZTbtSzUrtN8w4+J+1tca++dz5NgFW663Z941Yd+xD5L7107abxdm3GLv
wqRmX2uis7+icf1+AFBLAwQtAAAACAAAACEAhAYrY///////////CgAUAGJpYXNfMC5ucHkBABAAiAAAAAAAAABNAAAAAAAA
AJvsF+obEMnIUMZQrZ6SWpxcpG6loG6TZqKuo6Cell9UUpSYF59flJIKEndLzClOBYoXZyQWpAL5GkY6mjoKtQoUAK4Jv6r2
X/tuawcAUEsBAi0DLQAAAAgAAAAhAH3QqXGbAAAA+gAAAAgAAAAAAAAAAAAAAIABAAAAAHNwZWMubnB5UEsBAi0DLQAAAAgA
AAAhAHm8To5OAAAAkAAAAA4AAAAAAAAAAAAAAIAB1QAAAGFjdGl2YXRpb24ubnB5UEsBAi0DLQAAAAgAAAAhAETLApusAAAA
4AAAAAwAAAAAAAAAAAAAAIABYwEAAHdlaWdodF8wLm5weVBLAQItAy0AAAAIAAAAIQCEBitjTQAAAIgAAAAKAAAAAAAAAAAA
AACAAU0CAABiaWFzXzAubnB5UEsFBgAAAAAEAAQA5AAAANYCAAAAAA==
"""
