"""The ground of optimal control, without a problem: functions, programs as data, schemes, motions, statuses."""
