"""FluidsNet: learn a fluid from the particles of an SPH simulation."""

from fluidsnet.module import FluidsNet as FluidsNet
