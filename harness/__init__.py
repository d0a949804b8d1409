"""Record, replay, judge, measure, store; and the command line."""
