#!/bin/sh
[ -e /root/cast/pid ] || exit 0
read PID < /root/cast/pid
kill -TERM "$PID"
