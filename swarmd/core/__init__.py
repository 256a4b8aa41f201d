"""The base layer of all packages: values, messages, codec, keys, errors, clock, processes."""
