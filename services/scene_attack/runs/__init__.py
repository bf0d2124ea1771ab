"""A job from spec to result: parse, prepare, execute, record, replay."""
