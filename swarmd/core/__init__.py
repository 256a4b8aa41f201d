"""What flows everywhere: values, messages, codec, keys, errors, clock, threads, processes."""
