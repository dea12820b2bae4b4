"""Dark captures of known scenes, and assertions with known truth, for tests of anybody's reconstructor.

A test module or the topmost conftest.py says `pytest_plugins = ["novags.testing"]`; then `dark_capture` is a fixture:
`dark = dark_capture("cornell", 20)` has `dark.train` to reconstruct from and `dark.test` for `assert_scores`.

PYTEST_DONT_REWRITE: a test module may import this before pytest does, which would be a warning otherwise; the
assertions bring their own messages.
"""

from novags.testing.assertions import assert_depth as assert_depth
from novags.testing.assertions import assert_noise as assert_noise
from novags.testing.assertions import assert_poses as assert_poses
from novags.testing.assertions import assert_scores as assert_scores
from novags.testing.effects import assert_effect as assert_effect
from novags.testing.fixtures import dark_capture as dark_capture
from novags.testing.fixtures import novags_store as novags_store
from novags.testing.known import DarkCapture as DarkCapture
from novags.testing.known import PosedViews as PosedViews
