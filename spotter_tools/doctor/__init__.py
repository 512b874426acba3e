"""The checks of `spotter doctor`: each finding says what is wrong and what to do."""
