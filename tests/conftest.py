"""Two XLA devices for all tests, so that what is shared between devices is tested as such."""

from quadwalk.train.devices import set_up_devices

set_up_devices(2)
