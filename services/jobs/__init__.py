"""A job from request to result: spec, record, queue, artifacts, execution."""
