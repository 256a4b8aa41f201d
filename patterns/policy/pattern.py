"""A learned policy: robots gather, as a small network requests.

CMA-ES (Hansen, "The CMA evolution strategy: a tutorial", arXiv 1604.00772) trained the network with
examples/learning/train_aggregation.py, under protection: 23 generations of ten candidates, each
with a run of four Waffle Pis.
"""

from __future__ import annotations

from swarmd.api import PolicyPattern


class Policy(PolicyPattern):
    """Requests what its network gives for six sectors of robots and six of obstacles."""

    group = "gather"
    network = """
UEsDBC0AAAAIAAAAIQB90Klx//////////8IABQAc3BlYy5ucHkBABAA+gAAAAAAAACbAAAAAAAAAJvsF+obEMnIUMZQrZ6S
WpxcpG6loF5Taqiuo6Cell9UUpSYF59flJIKEndLzClOBYoXZyQWpAL5GoZGRjqaOgq1CmQDrmqlgsSikmIlq2gIS8lKqSg/
KR8ooqNUnJpckl8ElDPTUQK6Iz1VycpYz7RWB66yODkxD7s6Qz2D2lgdpZzEktSixBwlqzSw05UKUosy81OUrAz0jGoBUEsD
BC0AAAAIAAAAIQB5vE6O//////////8OABQAYWN0aXZhdGlvbi5ucHkBABAAkAAAAAAAAABOAAAAAAAAAJvsF+obEMnIUMZQ
rZ6SWpxcpG6loG4TaqKuo6Cell9UUpSYF59flJIKEndLzClOBYoXZyQWpAL5Gpo6CrUKFAGuEgYGhkQgzgPiDCAGAFBLAwQt
AAAACAAAACEAZWXw5///////////DAAUAHdlaWdodF8wLm5weQEAEADgAAAAAAAAAKwAAAAAAAAAm+wX6hsQychQxlCtnpJa
nFykbqWgbpNmoq6joJ6WX1RSlJgXn1+UkgoSd0vMKU4FihdnJBakAvkaRjoKhkaaOgq1CuQCrtsJafZv1521W7trhd0qn8v7
9exU7SdwHrHLkHdxmKFsvj/attI+Y12m3fk0mQNsa+/sq9VRdmCQ5jqQWFS0/0Evv01Z8xr7JlXZ/TbvD+7P5Omxv9qj69A9
5avd3aRL+/e/WLMfAFBLAwQtAAAACAAAACEAt7G2jf//////////CgAUAGJpYXNfMC5ucHkBABAAiAAAAAAAAABNAAAAAAAA
AJvsF+obEMnIUMZQrZ6SWpxcpG6loG6TZqKuo6Cell9UUpSYF59flJIKEndLzClOBYoXZyQWpAL5GkY6mjoKtQoUAK4lB3v2
/9/cagcAUEsBAi0DLQAAAAgAAAAhAH3QqXGbAAAA+gAAAAgAAAAAAAAAAAAAAIABAAAAAHNwZWMubnB5UEsBAi0DLQAAAAgA
AAAhAHm8To5OAAAAkAAAAA4AAAAAAAAAAAAAAIAB1QAAAGFjdGl2YXRpb24ubnB5UEsBAi0DLQAAAAgAAAAhAGVl8OesAAAA
4AAAAAwAAAAAAAAAAAAAAIABYwEAAHdlaWdodF8wLm5weVBLAQItAy0AAAAIAAAAIQC3sbaNTQAAAIgAAAAKAAAAAAAAAAAA
AACAAU0CAABiaWFzXzAubnB5UEsFBgAAAAAEAAQA5AAAANYCAAAAAA==
"""
