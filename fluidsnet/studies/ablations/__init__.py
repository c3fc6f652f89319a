"""``fluidsnet ablations``: what the paper claims of target and global feature, tried."""
