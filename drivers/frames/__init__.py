"""Any IMU by description: the frame language, the decoder and the encoder.

    >>> from drivers.frames.decoder import StreamDecoder
    >>> from drivers.frames.description import load_description
    >>> from drivers.frames.layout import encode
    >>> description = load_description("configs/imus/mfs.yaml")
    >>> data = encode(description, "sample", {"rate_A1": [22.08, 22.09], "counter": [0, 1]})
    >>> decoded = StreamDecoder(description).feed(data, arrival_s=0.0)
    >>> decoded["sample"].column("rate_A1").round(2)  # deg/hr, shape (n,)
    array([22.08, 22.09])
    >>> decoded.counts.lost
    0

What is damaged, cut or unknown is counted and never handed out.
"""
