"""The flap as a soft body of PyBullet; importing `flap` needs the extra `bullet` nowhere but to make one."""
