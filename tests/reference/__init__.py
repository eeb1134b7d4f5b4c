"""Slow or historical procedures that are compared with the product and use its parts; no user needs them."""
