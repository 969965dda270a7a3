"""What is measured and compared, by topic; modules that run as `python -m bench.TOPIC.MODULE` from the project root."""
