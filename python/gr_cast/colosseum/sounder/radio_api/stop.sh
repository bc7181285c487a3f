#!/bin/sh
: > /root/cast/stop
