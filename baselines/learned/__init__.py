"""Learned policies: networks, their files, and the kernel that flies them."""
