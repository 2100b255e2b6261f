#!/bin/sh
# isolated: neither the user's Python settings nor the current folder reach the service
exec /usr/bin/python3 -I -X faulthandler /usr/lib/sunarc/launch.py "$@"
