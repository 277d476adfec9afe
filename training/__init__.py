# SPDX-License-Identifier: GPL-3.0-or-later
"""Training of the multi-view-stereo network on rendered scenes."""
